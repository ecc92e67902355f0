"""Serves one node's connection: reads packets, answers requests, and sends what the node subscribed to.

What a node publishes goes to the space, which orders it by time and version, keeps it and gives it to other nodes as it
is: it is a value of the store and no sample, so there is no passage here. Where a map shares a topic of nodes with a
graph, a bridge of ``ropeway.gateway.nodes`` does, and its messages take the passage of that bridge.
"""

from __future__ import annotations

import asyncio
import json
import logging
import time
from collections.abc import Callable
from functools import partial
from typing import Any, Final

from ropeway.errors import AccessDenied, StoreUnavailable, TypesError, ValueRefused
from ropeway.iort import KINDS, Fault, NodeError, Packet, is_http, origin_of, pack
from ropeway.limits import HTTP_HEAD_BYTES, WRONG_TOKENS_PER_CONNECTION
from ropeway.listener.authorization import Access
from ropeway.listener.lobby import Visit
from ropeway.networks.iort.server.answers import (
    OURS,
    error_packet,
    event_packet,
    no_value,
    plain_packet,
    value_packet,
)
from ropeway.networks.iort.server.connection import NodeConnection
from ropeway.networks.iort.server.host import NodesHost
from ropeway.networks.iort.server.pushes import Pushes
from ropeway.networks.iort.space import MemberEndpoint, is_pattern
from ropeway.store import Entry, as_json

__all__ = ["IortSession"]

log = logging.getLogger("ropeway.iort")

_IDENTIFIER_CHARACTERS: Final = 40  # of one that is shown in the status


class IortSession(NodeConnection):
    """The conversation with one node, which is a member of the space."""

    __slots__ = (
        "_login",
        "_named",
        "_pushes",
        "_visit",
        "_watching",
        "_wrong_tokens",
        "access",
        "identifier",
        "kind",
        "node",
        "origin",
        "peer",
        "pings",
        "server",
        "space",
        "superseded",
        "upgraded",
    )

    def __init__(self, server: NodesHost[IortSession], visit: Visit) -> None:
        super().__init__(min(server.max_packet_bytes, HTTP_HEAD_BYTES))  # until it is let in
        self.server, self.space = server, server.space
        self._visit = visit
        self._login: asyncio.TimerHandle | None = None
        self._wrong_tokens = 0
        self.node = ""
        self.peer = ""
        self.kind = ""  # one of KINDS, where the node or the configuration tells
        self.identifier = ""  # of its packets
        self.access: Access | None = None
        self.upgraded = False
        self.pings = False  # it says now and then that it is there
        self.origin = ""
        self._named: tuple[tuple[str, str], str] = ("", ""), ""  # of values, and who is said to have written them
        self.superseded = 0
        self._pushes = Pushes(self._superseded)
        self._watching = False

    # ── coming and going ───────────────────────────────────────────────────────────────────────────────────────

    def connection_made(self, transport: asyncio.BaseTransport) -> None:
        """Take a new node's connection."""
        super().connection_made(transport)
        assert self.transport is not None
        self._visit.drop = self.transport.abort
        self.server.welcome(self, self.transport)

    def expect_login(self, seconds: float) -> None:
        """Give the node up unless it is let in within ``seconds``."""
        self._login = asyncio.get_running_loop().call_later(seconds, self.server.too_late, self)

    def let_in(self, access: Access, max_packet_bytes: int) -> None:
        """Admit the node with the rights of ``access``, and packets of up to ``max_packet_bytes``."""
        self.access, self.trusted = access, True
        self._parser.max_bytes = max_packet_bytes
        self._end_visit()

    def _end_visit(self) -> None:
        self._visit.leave()
        if self._login is not None:
            self._login.cancel()
            self._login = None

    def connection_lost(self, exc: Exception | None) -> None:
        """Clean up after a connection that is gone."""
        super().connection_lost(exc)
        self._end_visit()
        self._pushes.clear()
        self.server.gone(self)

    def began_to_speak(self, data: bytes) -> bool:
        """See ``NodeConnection``: a browser is sent away."""
        if is_http(data):
            self.server.browser_came(self)
            return False
        return self.server.heard(self)

    def came(self, item: Packet | Fault) -> None:
        """See ``NodeConnection``."""
        if isinstance(item, Packet):
            self._packet(item)
        else:
            self._fault(item)

    def caught_up(self) -> bool:
        """See ``NodeConnection``: the newest value of the topic that has waited longest."""
        taken = self._pushes.take()
        if taken is None:
            return False
        self._pushed(*taken)
        return True

    # ── sending ────────────────────────────────────────────────────────────────────────────────────────────────

    def close(self, code: str = "", text: str = "") -> None:
        """End the connection; ``code`` and ``text`` tell an upgraded node why."""
        if code and self.upgraded:
            self._error("", code, text)
        self.end()

    def _error(self, number: str, code: str, text: str) -> None:
        self._send(error_packet(number, code, text))

    def _ok(self, number: str, **head: object) -> None:
        if number:
            self._send(pack(OURS, "-", "-", "+ok", {"n": number, **head}))

    def _text(self, entry: Entry) -> bytes:
        """Return the text for a node. Raises ``NodeError`` where a message of ROS cannot be made text."""
        if not entry.form:
            return entry.data
        try:
            return self.server.render(entry)
        except TypesError as error:
            raise NodeError("conversion", str(error)) from None

    def _pushed(self, entry: Entry, latest: bool) -> None:
        """Send a value of a subscription."""
        try:
            self._send(value_packet(entry, self._text(entry), latest=latest))
        except NodeError as error:
            self.server.counts[error.code] += 1

    # ── what the space calls ───────────────────────────────────────────────────────────────────────────────────

    def value(self, entry: Entry, latest: bool) -> None:
        """Send a value of a topic that the node subscribed to."""
        if self.access is None or not self.access.allows("subscribe", f"/{entry.system}/{entry.topic}"):
            return
        if not self._paused and self._flow.free and not self._pushes:
            self._pushed(entry, latest)
        else:
            self._pushes.put(entry, latest)

    def _superseded(self) -> None:
        self.superseded += 1
        self.server.counts["superseded"] += 1

    def event(self, endpoint: MemberEndpoint, there: bool) -> None:
        """Tell the node that a member began or ceased to publish or read."""
        if self.access is None or not self.access.allows("subscribe", f"/{endpoint.system}/{endpoint.topic}"):
            return
        self._send(event_packet(endpoint, there))

    def kept(self, tokens: list[Any], error: StoreUnavailable | None) -> None:
        """Confirm the values that now survive a crash, as the store reports."""
        if error is None:
            answers = [f"%00/-/-/+ok/n={number},v={version}%" for number, version in tokens]
            self._send("".join(answers).encode())
            return
        self.server.counts["not-kept"] += len(tokens)
        for number, _ in tokens:
            self._error(number, "not-kept", f"the value is served but not kept yet: {error}")

    # ── packets ────────────────────────────────────────────────────────────────────────────────────────────────

    def _fault(self, fault: Fault) -> None:
        self.server.counts[fault.code] += 1
        if self.upgraded:
            self._error("", fault.code, fault.text)

    def _packet(self, packet: Packet) -> None:
        op = packet.op
        self.server.counts["packets"] += 1
        number = ""
        if op[0] == "+":
            self.upgraded = True
            number = packet.head.get("n", "")
            if "," in number or "=" in number or len(number) > 40:
                self._error("", "malformed", "n is a short number")
                return
        try:
            if self.access is None and op not in _FOR_STRANGERS:
                raise NodeError("login", "who are you? +hello with a token, or a certificate, is needed here")
            if op == "p":
                self._publish_plain(packet)
            elif op == "s":
                self._read_plain(packet)
            elif op == "d":
                self.close()
            elif op == "+pub":
                self._publish(packet, number)
            else:
                handler = _HANDLERS.get(op)
                if handler is None:
                    raise NodeError("malformed", f"{op[:20]} is not known here")
                handler(self, packet, number)
        except NodeError as error:
            self._refuse(packet, number, error.code, error.text)
            if op == "+hello":
                self._refused_hello()
        except ValueRefused as error:
            self._refuse(packet, number, error.code, str(error))
        except AccessDenied as error:
            self._refuse(packet, number, "denied", str(error))

    def _refuse(self, packet: Packet, number: str, code: str, text: str) -> None:
        self.server.counts[code] += 1
        if packet.op == "s":
            text = text.replace("%", "")
            self._send(pack(OURS, packet.system, packet.topic, "e", None, text.encode(), packet.system_type))
        elif self.upgraded:
            self._error(number, code, text)

    def _refused_hello(self) -> None:
        self._wrong_tokens += 1
        if self._wrong_tokens >= WRONG_TOKENS_PER_CONNECTION:
            self.close()

    def _may(self, verb: str, packet: Packet) -> Access:
        access = self.access
        assert access is not None  # strangers do not get here
        access.check(verb, f"/{packet.system}/{packet.topic}")
        if access.limited:
            access.spend(verb, f"/{packet.system}/{packet.topic}", len(packet.data))
        if verb == "publish":
            access.command(verb, f"/{packet.system}/{packet.topic}", packet.data)
        return access

    def _publish_plain(self, packet: Packet) -> None:
        self._may("publish", packet)
        self._known_as(packet.id)
        self.space.publish(self, packet.system, packet.topic, packet.data, origin=self._origin_of(packet.id))

    def _known_as(self, identifier: str) -> None:
        """Note the identifier of a plain packet; the configuration may say what kind of node has it."""
        if identifier != self.identifier:
            self.identifier = identifier[:_IDENTIFIER_CHARACTERS]
            if not self.upgraded:
                self.kind = self.server.kinds.get(identifier, "")

    def _origin_of(self, identifier: str) -> str:
        """Return who wrote a value that does not say so; all values of a node have the same text."""
        about = (identifier, self.kind)
        if self._named[0] != about:
            self._named = about, origin_of(identifier, self.peer, self.kind)
        return self._named[1]

    def _read_plain(self, packet: Packet) -> None:
        self._known_as(packet.id)
        self._answer_read(packet, partial(self._answer_plain, packet), "")

    def _answer_plain(self, packet: Packet, entry: Entry) -> None:
        self._send(plain_packet(packet, entry, self._text(entry)))

    def _answer_read(self, packet: Packet, answer: Callable[[Entry], None], number: str) -> None:
        """Answer a read; a value that is not here is looked up in the database elsewhere, if there is one."""
        self._may("subscribe", packet)
        store = self.space.store
        entry = store.get(packet.system, packet.topic)
        if entry is not None:
            answer(entry)
        elif store.may_find(packet.system, packet.topic):
            self._looking = True
            self.server.spawn(self._look_further(packet, answer, number))
        else:
            raise no_value(packet, store.has_system(packet.system))

    async def _look_further(self, packet: Packet, answer: Callable[[Entry], None], number: str) -> None:
        store = self.space.store
        try:
            knows_system = await store.find(packet.system, packet.topic)
            entry = store.get(packet.system, packet.topic)
            if self.transport is None:
                return
            if entry is None:
                raise no_value(packet, knows_system)
            answer(entry)
        except NodeError as error:
            self._refuse(packet, number, error.code, error.text)
        finally:
            self._looking = False
            self._work()

    def _publish(self, packet: Packet, number: str) -> None:
        head = packet.head
        self._may("publish", packet)
        try:
            stamp_ns, version = int(head.get("t", "0")), int(head.get("v", "0"))
        except ValueError:
            raise NodeError("malformed", "t and v are whole numbers") from None
        if not (0 <= stamp_ns < 1 << 63 and 0 <= version < 1 << 63):
            raise NodeError("malformed", "t and v are whole numbers of up to 63 bits")
        merge = head.get("m") == "1"
        origin = head.get("o") or self.origin or self._origin_of(packet.id)
        token = [number, version]
        entry = self.space.publish(
            self,
            packet.system,
            packet.topic,
            packet.data,
            origin=origin[:200],
            stamp_ns=stamp_ns,
            version=version,
            merge=merge,
            type=head.get("k", "")[:200],
            sink=self if number else None,
            token=token,
        )
        token[1] = entry.version

    def _hello(self, packet: Packet, number: str) -> None:
        note = self.server.hello(self, packet.system, packet.head.get("token"))
        kind = packet.head.get("kind", "")
        self.kind = kind if kind in KINDS else self.server.kinds.get(packet.id, "")
        self.identifier = packet.id[:_IDENTIFIER_CHARACTERS]
        self.origin = packet.head.get("o", "")[:200] or origin_of(packet.id, f"{packet.system}@{self.peer}", self.kind)
        answer = {"n": number, "t": time.time_ns(), "max": self._parser.max_bytes}
        self._send(pack(OURS, "-", "-", "+ok", answer, note.encode()))

    def _get(self, packet: Packet, number: str) -> None:
        def answer(entry: Entry) -> None:
            if number:
                self._send(value_packet(entry, self._text(entry), number=number))

        self._answer_read(packet, answer, number)

    def _subscribe(self, packet: Packet, number: str) -> None:
        if not (is_pattern(packet.system) or is_pattern(packet.topic)):  # else each value is looked at when it comes
            self._may("subscribe", packet)
        self.space.check_subscription(self, packet.system, packet.topic)
        self._ok(number)
        latest, head = packet.head.get("last", "1") == "1", packet.head
        self.space.subscribe(
            self, packet.system, packet.topic, latest=latest, type=head.get("k", ""), qos=head.get("q", "")
        )

    def _unsubscribe(self, packet: Packet, number: str) -> None:
        self.space.unsubscribe(self, packet.system, packet.topic)
        self._ok(number)

    def _advertise(self, packet: Packet, number: str) -> None:
        self._may("publish", packet)
        head = packet.head
        self.space.advertise(self, packet.system, packet.topic, head.get("k", "")[:200], head.get("q", "")[:2000])
        self._ok(number)

    def _withdraw(self, packet: Packet, number: str) -> None:
        self.space.withdraw(self, packet.system, packet.topic)
        self._ok(number)

    def _watch(self, packet: Packet, number: str) -> None:
        self._ok(number)
        if not self._watching:
            self._watching = True
            self.space.watch(self)

    def _list(self, packet: Packet, number: str) -> None:
        access = self.access
        assert access is not None
        found = [
            as_json(entry, age_s=round(entry.age_s(), 3))
            for entry in self.space.store.entries(packet.system, packet.topic)
            if access.allows("subscribe", f"/{entry.system}/{entry.topic}")
        ]
        if number:
            self._send(pack(OURS, "-", "-", "+val", {"n": number}, json.dumps(found).encode()))

    def _delete(self, packet: Packet, number: str) -> None:
        self._may("publish", packet)
        self._looking = True
        self.server.spawn(self._deleted(packet, number))

    async def _deleted(self, packet: Packet, number: str) -> None:
        try:
            there = await self.space.store.remove(packet.system, packet.topic)
        except StoreUnavailable as error:
            self._error(number, "not-kept", str(error))
        else:
            if there:
                self._ok(number)
            else:
                self._error(number, "unknown-topic", f"no value of {packet.system}/{packet.topic} is there")
        finally:
            self._looking = False
            self._work()

    def _ping(self, packet: Packet, number: str) -> None:
        self.pings = True
        self._send(pack(OURS, "-", "-", "+ok", {"n": number, "t": time.time_ns()} if number else None))

    def _bye(self, packet: Packet, number: str) -> None:
        self._ok(number)
        self.close()


_FOR_STRANGERS: Final = frozenset(("+hello", "+ping", "+bye", "d"))  # what a node may say that is not in
_HANDLERS: Final[dict[str, Callable[[IortSession, Packet, str], None]]] = {
    "+hello": IortSession._hello,
    "+get": IortSession._get,
    "+sub": IortSession._subscribe,
    "+unsub": IortSession._unsubscribe,
    "+adv": IortSession._advertise,
    "+unadv": IortSession._withdraw,
    "+watch": IortSession._watch,
    "+list": IortSession._list,
    "+del": IortSession._delete,
    "+ping": IortSession._ping,
    "+bye": IortSession._bye,
}
