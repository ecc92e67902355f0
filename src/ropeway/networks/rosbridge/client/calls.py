"""The calls and goals on one link: who waits for which answer, and who gets what arrives."""

from __future__ import annotations

import asyncio
import itertools
import re
from collections.abc import Callable, Mapping
from typing import TYPE_CHECKING, Any, Final, Protocol

from ropeway import aio
from ropeway.errors import GraphUnavailable, InvalidName, RopewayError
from ropeway.graph.base import NO_HINTS, Delivery, Undelivered
from ropeway.graph.begun import into
from ropeway.networks.rosbridge.client.bodies import Bodies
from ropeway.networks.rosbridge.client.other_holder import OtherHolder
from ropeway.networks.rosbridge.protocol import ops
from ropeway.networks.rosbridge.protocol.dialect import ROPEWAY

if TYPE_CHECKING:
    from ropeway.networks.rosbridge.client.host import LinkGraph
    from ropeway.networks.rosbridge.link.peer import Peer

__all__ = ["Answered", "Calls", "RemoteCaller", "announced", "answer_encoding", "lane", "travelling"]

_NOBODY_S: Final = 1.0  # where nobody can tell who serves what, a call that is not served is tried again for so long
_RETRY_S: Final = 0.25
_UNTOLD: Final = "/rosapi/"  # a gateway's own services: it answers them, and does not list them
_OURS: Final = re.compile(r"(?:call_service|send_action_goal):\S+:\d+")


Answered = Callable[[ops.ServiceResponse | BaseException], None]
"""Takes the answer to a call, or why there is none."""


class RemoteCaller(Protocol):
    """A client of a service or an action."""

    name: str

    @property
    def available(self) -> bool | None:
        """See ``Client``."""

    async def close(self) -> None:
        """Stop calling."""


class RemoteProvider(Protocol):
    """Serves a service or an action over a link."""

    name: str
    type: str
    held: OtherHolder

    def connected(self, peer: Peer) -> None:
        """Announce it on a new connection. Raises ``UnknownType`` if the peer needs the definition."""
        ...

    def disconnected(self) -> None:
        """Note that the connection is gone."""
        ...

    async def close(self) -> None:
        """Stop serving."""
        ...


class ServiceProvider(RemoteProvider, Protocol):
    """Serves a service over a link."""

    def called(self, op: ops.CallService, peer: Peer) -> None:
        """Take a call."""
        ...


class ActionProvider(RemoteProvider, Protocol):
    """Serves an action over a link."""

    def asked(self, op: ops.SendActionGoal, peer: Peer) -> None:
        """Take a goal."""
        ...

    def cancel_asked(self, op: ops.CancelActionGoal, peer: Peer) -> None:
        """Take a request to cancel a goal."""
        ...


class GoalUnderWay(Protocol):
    """A goal that was sent over a link."""

    def accept(self) -> None:
        """Note that the far side accepts the goal."""
        ...

    def fed(self, op: ops.ActionFeedback) -> None:
        """Deliver a feedback."""
        ...

    def ended(self, op: ops.ActionResult) -> None:
        """Take the result."""
        ...

    def cancel_answered(self, agreed: bool) -> None:
        """Note whether the far side accepts the cancellation."""
        ...

    def lost(self, reason: str) -> None:
        """Fail or abort the goal: the link has gone."""
        ...


class Calls:
    """Manages the services and actions of a ``RosbridgeGraph``. It outlives connections."""

    def __init__(self, graph: LinkGraph) -> None:
        self.graph = graph
        self.bodies = Bodies(graph)
        self.pending: dict[str, Answered] = {}
        self.goals: dict[str, GoalUnderWay] = {}
        self.services: dict[str, ServiceProvider] = {}
        self.servers: dict[str, ActionProvider] = {}
        self.clients: dict[RemoteCaller, None] = {}
        self.peer: Peer | None = None  # once it can be called
        self.numbers = itertools.count(1)
        """Numbers that no call or goal of this graph has had."""
        self._changed = asyncio.Event()
        self._turns: dict[str, asyncio.Lock] = {}

    # ── for the parts ──────────────────────────────────────────────────────────────────────────────────────────

    def turn(self, service: str) -> asyncio.Lock:
        """Return the lock of a service whose peer answers one call at a time."""
        return self._turns.setdefault(service, asyncio.Lock())

    async def link(self, deadline: float) -> Peer:
        """Return the peer, as soon as it can be called.

        Raises ``GraphUnavailable`` at the deadline (time of the loop).
        """
        if (peer := self.peer) is not None:
            return peer
        try:
            async with aio.timeout_at(deadline):
                while (peer := self.peer) is None:
                    await self._changed.wait()
        except TimeoutError:
            raise GraphUnavailable(
                self.graph.name, f"the link is down ({self.graph.last_error or 'it is being made again'})"
            ) from None
        return peer

    def available(self, kind: str, name: str) -> bool | None:
        """Return whether the far graph shows a provider of a name; ``kind`` is ``service`` or ``action``."""
        peer = self.peer
        if peer is None:
            return False
        if not self._told(peer):
            return None
        mirror = self.graph.mirror
        info = mirror.services.get(name) if kind == "service" else mirror.actions.get(name)
        if info is None and kind == "service" and name.startswith(_UNTOLD):
            return None
        return info is not None and bool(info.servers)

    def _told(self, peer: Peer) -> bool:
        return peer.dialect is ROPEWAY and self.graph.mirror.tells_calls

    async def wait_available(self, caller: RemoteCaller, timeout_s: float) -> bool:
        """Wait until somebody serves it, or nobody can tell."""
        try:
            async with aio.timeout(timeout_s):
                while caller.available is False:
                    await self._changed.wait()
        except TimeoutError:
            return False
        return True

    async def may_try_again(self, caller: RemoteCaller, began: float, deadline: float) -> bool:
        """Wait, after a call that was not served, until another is worthwhile; return false if none is within the time.
        False when it is not, within the time.
        """
        loop = asyncio.get_running_loop()
        if caller.available is None:
            deadline = min(deadline, began + _NOBODY_S)
        left = deadline - loop.time()
        if left <= 0:
            return False
        if caller.available is not False:  # it comes and goes, or nobody can tell
            try:
                async with aio.timeout(min(left, _RETRY_S)):
                    await self._changed.wait()
            except TimeoutError:
                pass
            return loop.time() < deadline
        return await self.wait_available(caller, left)

    async def plain(self, service: str, args: Mapping[str, Any], timeout_s: float = 5.0) -> Mapping[str, Any]:
        """Call a service by JSON and give its values. Raises ``GraphUnavailable`` with the server's text."""
        name, peer = self.graph.name, self.graph.peer
        if peer is None:
            raise GraphUnavailable(name, "is not connected")
        id = f"call_service:{service}:{next(self.numbers)}"
        future: asyncio.Future[ops.ServiceResponse] = asyncio.get_running_loop().create_future()
        self.pending[id] = into(future)
        try:
            peer.send(ops.CallService(id=id, service=service, args=dict(args)))
            async with aio.timeout(timeout_s):
                response = await future
        except TimeoutError:
            raise GraphUnavailable(name, f"{service} did not answer within {timeout_s:g} s") from None
        finally:
            self.pending.pop(id, None)
        if not response.result or not isinstance(response.values, Mapping):
            raise GraphUnavailable(name, f"{service}: {response.values}")
        return response.values

    def changed(self) -> None:
        """Wake those who wait: the providers have changed."""
        self._changed.set()
        self._changed = asyncio.Event()

    def late(self, name: str) -> None:
        """Count an answer for which nobody waits."""
        self.graph.drops[name, Undelivered.LATE] += 1

    def add(self, part: RemoteProvider, table: dict[str, Any]) -> None:
        """Keep a provider, and offer it. Raises ``InvalidName`` for a second one, and what the peer cannot take."""
        if part.name in table:
            raise InvalidName(part.name, f"it is served on {self.graph.name} by this program already")
        table[part.name] = part
        if self.graph.peer is not None:
            try:
                part.connected(self.graph.peer)
            except RopewayError:
                del table[part.name]
                raise

    def providers(self) -> list[RemoteProvider]:
        """Return what is served over this link."""
        return [*self.services.values(), *self.servers.values()]

    async def close(self) -> None:
        """Close every part."""
        for client in list(self.clients):
            await client.close()
        for provider in self.providers():
            await provider.close()
        self.changed()

    # ── the connection ─────────────────────────────────────────────────────────────────────────────────────────

    def ready(self, peer: Peer) -> None:
        """Take a peer that can be called."""
        self.peer = peer
        self.changed()

    def disconnected(self) -> None:
        """Fail everything under way: the link is gone, so it cannot be answered."""
        self.peer = None
        self.bodies.clear()
        reason = f"the link to {self.graph.name} was lost"
        pending, self.pending = self.pending, {}
        for answered in pending.values():
            answered(GraphUnavailable(self.graph.name, "the connection was lost during the call"))
        goals, self.goals = self.goals, {}
        for goal in goals.values():
            goal.lost(reason)
        for part in self.providers():
            part.disconnected()
        self.changed()

    # ── what the peer says ─────────────────────────────────────────────────────────────────────────────────────

    def operation(self, op: ops.Op, peer: Peer) -> bool:
        """Take an operation of services and actions; false for others."""
        match op:
            case ops.ServiceResponse():
                answered = self.pending.pop(str(op.id), None)
                if answered is not None:
                    answered(op)
                else:
                    self._unasked(op.service, op.id, peer)
            case ops.ActionFeedback():
                if (goal := self.goals.get(str(op.id))) is not None:
                    goal.fed(op)
                else:
                    self._unasked(op.action, op.id, peer)
            case ops.ActionResult():
                if (goal := self.goals.pop(str(op.id), None)) is not None:
                    goal.ended(op)
                else:
                    self._unasked(op.action, op.id, peer)
            case ops.CallService():
                if (service := self.services.get(op.service) or self.services.get(op.name)) is not None:
                    service.called(op, peer)
                else:
                    text = f"Service {op.name} does not exist"
                    peer.send_op(ops.ServiceResponse(id=op.id, service=op.service, values=text, result=False))
            case ops.SendActionGoal():
                if (server := self.servers.get(op.name)) is not None:
                    server.asked(op, peer)
                else:
                    text = "No action server available"
                    peer.send_op(ops.ActionResult(id=op.id, action=op.action, values=text, status=0, result=False))
            case ops.CancelActionGoal():
                if (server := self.servers.get(op.name)) is not None:
                    server.cancel_asked(op, peer)
                elif peer.dialect is ROPEWAY and ops.present(op.id):
                    peer.send_op({"op": "cancelling", "id": op.id, "agreed": False})
            case _:
                return False
        return True

    def _unasked(self, name: str, id: object, peer: Peer) -> None:
        """Count an answer that came late, or to no call."""
        if any(client.name == name for client in self.clients):
            self.late(name)
        elif isinstance(id, str) and _OURS.fullmatch(id):  # of a client that was closed
            self.late("")
        else:
            peer.fault_log.note("answer", name, "no request here matches it")

    def control(self, message: Mapping[str, Any]) -> bool:
        """Take a message between gateways about services and actions; false for others."""
        op, id = message.get("op"), message.get("id")
        if op in ("accepted", "cancelling"):
            goal = self.goals.get(id) if isinstance(id, str) else None
            if goal is not None and op == "accepted":
                goal.accept()
            elif goal is not None:
                goal.cancel_answered(message.get("agreed") is True)
            return True
        if op in ("refused", "granted"):
            for kind, table in (("service", self.services), ("action", self.servers)):
                name = message.get(kind)
                if isinstance(name, str):
                    part = table.get(name)
                    if part is not None:
                        by = message.get("taken_by")  # gateways before this field tell it in their reason
                        reason = by if isinstance(by, str) else str(message.get("reason", ""))
                        part.held.tell("" if op == "granted" else (reason or "it was refused")[:1000])
                    return True
        return False


def announced(delivery: Delivery, peer: Peer) -> str | None:
    """Return the encoding to name when something is offered to a peer: what it may send requests in."""
    dialect, encoding = peer.dialect, delivery.encoding
    known = dialect is ROPEWAY or encoding in dialect.bodies
    return encoding if dialect.names_compression and known and encoding != "auto" else None


def answer_encoding(delivery: Delivery, peer: Peer, op: ops.CallService | ops.SendActionGoal) -> str:
    """Return the encoding for answers to a request: what the peer asked for, or between gateways what is configured."""
    if peer.dialect is not ROPEWAY:
        return op.compression or "none"
    wanted = (op.ropeway or {}).get("encoding")
    return wanted if isinstance(wanted, str) and wanted != "auto" else delivery.encoding


def lane(delivery: Delivery) -> int | None:
    """Return the priority of calls: the configured one, or ``None`` to choose by size."""
    return None if delivery.priority == NO_HINTS.priority else delivery.priority


def travelling(delivery: Delivery, peer: Peer | None, asked: str | None) -> str:
    """Return the encoding in which bodies travel: as configured between gateways, else as the peer ``asked`` for."""
    if peer is None or peer.dialect is ROPEWAY:
        return delivery.encoding
    return asked if asked in peer.dialect.bodies else "none"
