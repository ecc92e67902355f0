"""The client role: a connection to a rosbridge server or gateway that reconnects and restores everything on it."""

from __future__ import annotations

import asyncio
import contextlib
import itertools
import logging
import ssl
import time
from collections.abc import Awaitable, Callable, Mapping, Sequence
from functools import partial
from typing import Any, Final

from ropeway import aio
from ropeway.errors import ConnectFailed, GraphUnavailable, RopewayError
from ropeway.graph.base import (
    NO_HINTS,
    Delivery,
    NodeInfo,
    SampleCallback,
    TopicInfo,
    resolve_name,
)
from ropeway.graph.calls import ActionHandlers, ActionInfo, ProviderInfo, ServiceHandler, ServiceInfo
from ropeway.graph.graph_base import GraphBase
from ropeway.graph.layout_border import Border
from ropeway.listener.connection import Connection, Limits
from ropeway.listener.http import without_token
from ropeway.listener.websocket import connect
from ropeway.networks.rosbridge.client.actions import RemoteActionClient
from ropeway.networks.rosbridge.client.calls import Calls
from ropeway.networks.rosbridge.client.definitions import RemoteDefinitions
from ropeway.networks.rosbridge.client.echoes import EchoFilter
from ropeway.networks.rosbridge.client.mirror import RemoteMirror
from ropeway.networks.rosbridge.client.parts import RemotePublisher, RemoteSubscription
from ropeway.networks.rosbridge.client.plain_servers import PlainServer
from ropeway.networks.rosbridge.client.reconnect import LinkState, Reconnect
from ropeway.networks.rosbridge.client.refusals import answer_invalid
from ropeway.networks.rosbridge.client.ros1_spelling import Spelling
from ropeway.networks.rosbridge.client.second_connection import keep_second
from ropeway.networks.rosbridge.client.servers import RemoteActionServer
from ropeway.networks.rosbridge.client.services import RemoteClient, RemoteService
from ropeway.networks.rosbridge.link.calls import OP_CHANNELS
from ropeway.networks.rosbridge.link.express import HEADER as EXPRESS_HEADER
from ropeway.networks.rosbridge.link.peer import Peer, Wrapping
from ropeway.networks.rosbridge.protocol import ops
from ropeway.networks.rosbridge.protocol.codec import unpack_png
from ropeway.networks.rosbridge.protocol.dialect import ROPEWAY, ROPEWAY_SUBPROTOCOL
from ropeway.networks.rosbridge.protocol.records import Arrival
from ropeway.qos import DEFAULT, QoS
from ropeway.tasks import Supervised, end
from ropeway.types import TypeRegistry

__all__ = ["LinkState", "RosbridgeGraph"]

log = logging.getLogger("ropeway.rosbridge")

_CLOCK_S: Final = 1.0
_ROSAPI_S: Final = 3.0
_US: Final = ProviderInfo(local=True)


class RosbridgeGraph(GraphBase):
    """The graph behind ``url`` (``ws://`` or ``wss://``).

    With ``wait`` true ``open`` returns when connected, or raises ``ConnectFailed``; with false it returns at once
    and the connection is made in the background. Either way a lost connection is made again, for ever, and every
    publisher, subscription, service and action is announced again. ``watch`` asks the far side what it has: a
    gateway tells, a plain server is asked through rosapi (unless ``ask_rosapi`` is false). ``plain`` speaks
    rosbridge even to a gateway. ``ros1`` tells whether a plain server is one of ROS 1; left out, it is found out.
    ``network`` has the types of the far side where they are known not to be those of ``registry``.
    """

    kind = "rosbridge"

    def __init__(
        self,
        url: str,
        *,
        registry: TypeRegistry | None = None,
        limits: Limits | None = None,
        ssl_context: ssl.SSLContext | None = None,
        headers: Mapping[str, str] | None = None,
        gateway_id: str = "",
        name: str = "ropeway",
        wait: bool = True,
        watch: bool = True,
        ask_rosapi: bool = True,
        plain: bool = False,
        ros1: bool | None = None,
        network: TypeRegistry | None = None,
    ) -> None:
        self._url = url
        super().__init__(shown := without_token(url))
        ours = registry or TypeRegistry()
        self.registry = network or ours
        self.border = Border(ours, network)
        self.echoes: dict[str, EchoFilter] = {}
        self.peer: Peer | None = None
        self.remote: dict[str, Any] = {}
        self.connections = 0
        self._ssl = ssl_context
        self._headers = headers
        self.gateway_id, self._node_name = gateway_id, name
        self._wait, self._watch, self._plain = wait, watch, plain
        self._ask_rosapi = ask_rosapi
        self._numbers = itertools.count(1)
        self._publishers: dict[int, RemotePublisher] = {}
        self._subscriptions: dict[int, RemoteSubscription] = {}
        self.calls: Calls = Calls(self)
        self.mirror = RemoteMirror(shown, self._changes, self.calls.changed)
        self._keeper = Reconnect(shown, limits or Limits(), self._connect)
        self._noted_types: set[str] = set()
        self.plain_server = PlainServer(shown, self.registry)
        self.spelling = Spelling(self, ros1)
        self.teller = RemoteDefinitions(self)
        self._traffic = (0, 0)
        self._rosapi_error = ""
        self._wants_calls = False  # somebody asked what is served there

    # ── opening, the connection, closing ───────────────────────────────────────────────────────────────────────

    @property
    def state(self) -> LinkState:
        """The state of the connection."""
        return self._keeper.state

    @property
    def last_error(self) -> str:
        """The reason why the last attempt failed, ``""`` while connected."""
        return self._keeper.last_error

    def on_state(self, callback: Callable[[LinkState], None]) -> None:
        """Call with the state of the connection, now and at each change."""
        self._keeper.on_state(callback)

    def on_reached(self, callback: Callable[[bool], None]) -> None:
        """Call with whether the far side is connected, now and at each change."""
        self.on_state(lambda state: callback(state is LinkState.CONNECTED))

    def on_answer(self, callback: Callable[[str], None]) -> None:
        """See ``Answering.on_answer``: whether the server lets us in."""
        self._keeper.answers.on_answer(callback)

    async def open(self) -> None:
        """Connect; see the class for ``wait``."""
        keeper = self._keeper
        if keeper.started:
            return
        keeper.start()
        if not self._wait:
            return
        try:
            async with aio.timeout(keeper.limits.open_timeout_s + 1):
                await keeper.first()
                if self._watch:
                    await self.mirror.filled.wait()
        except TimeoutError:
            if self.peer is None:
                await self.close()
                raise ConnectFailed(self.name, "no answer in time") from None
        except ConnectFailed:
            await self.close()
            raise

    async def close(self) -> None:
        """Leave the far graph with everything that was created here."""
        if self._keeper.leaving:
            return
        self._keeper.leaving = True
        for part in self.parts():
            await part.close()
        await self.calls.close()
        self._keeper.set_state(LinkState.CLOSED)
        connection = self.peer.connection if self.peer is not None else None
        if connection is not None:
            connection.close(1000, "done")
            with contextlib.suppress(TimeoutError):
                async with aio.timeout(2):
                    await connection.wait_closed()
                    await self._keeper.left()
        await self._keeper.stop()
        self._changes.close()
        self.teller.leave()

    def renew(self, ssl_context: ssl.SSLContext | None, headers: Mapping[str, str], *, anew: bool) -> None:
        """Show and trust other credentials from the next connection on; with ``anew`` that is made at once."""
        self._ssl, self._headers = ssl_context, dict(headers)
        if anew and self.peer is not None:
            self.peer.connection.close(1000, "certificates were read again")

    async def _connect(self, limits: Limits) -> Callable[[], Awaitable[None]]:
        peers: list[Peer] = []
        connection = await connect(
            self._url,
            limits=limits,
            subprotocols=() if self._plain else (ROPEWAY_SUBPROTOCOL,),
            ssl_context=self._ssl,
            headers=self._headers,
            on_connection=lambda made: peers.append(Peer(made, self.registry, self)),
        )
        return lambda: self._converse(connection, peers[-1])

    async def _converse(self, connection: Connection, peer: Peer) -> None:
        self.peer = peer
        peer.on_invalid = partial(answer_invalid, peer, self.calls)
        self.connections += 1
        self._noted_types.clear()
        if peer.dialect is ROPEWAY:
            peer.hello(self.gateway_id, self._node_name)
            if self._watch:
                peer.send({"op": "watch"})
        else:
            self.plain_server.greet(peer)
        log.info("%s: connected (%s)", self.name, peer.dialect.name)
        began = time.monotonic()
        for part in self.parts():
            try:
                part.connected(peer)
            except RopewayError as error:  # one topic that cannot go to this peer must not hold up the others
                self._was_refused(part, str(error))
        for provider in self.calls.providers():
            try:
                provider.connected(peer)
            except RopewayError as error:
                provider.held.tell(str(error))
        if peer.dialect is not ROPEWAY or peer.greeted:
            self.calls.ready(peer)
        self._keeper.set_state(LinkState.CONNECTED)
        chores = Supervised(partial(self._chores, peer), f"chores {self.name}").start()
        second = Supervised(partial(keep_second, peer, self._second), f"second connection {self.name}").start()
        types = Supervised(self.teller.follow, f"definitions from {self.name}").start()
        try:
            code, reason = await connection.wait_closed()
        finally:
            await end(second, chores, types)
            self._traffic = (self._traffic[0] + connection.bytes_in, self._traffic[1] + connection.bytes_out)
            self._keeper.rtt_s = peer.rtt_s or 0.0
            self.peer = None
            channels = [p.channel for p in self._publishers.values() if p.channel is not None]
            self.plain_server.ended(peer, channels, time.monotonic() - began)
            for part in self.parts():
                part.disconnected()
            self.calls.disconnected()
            self.mirror.clear()
        if not self._keeper.leaving:
            log.warning("%s: disconnected (%d %s)", self.name, code, reason)

    async def _second(self, peer: Peer) -> Connection:
        """Open a second connection beside the one of ``peer``. Raises ``ConnectFailed``."""
        return await connect(
            self.name,
            limits=self._keeper.limits,
            subprotocols=(ROPEWAY_SUBPROTOCOL,),
            ssl_context=self._ssl,
            headers={**(self._headers or {}), EXPRESS_HEADER: peer.express.offered},
            on_connection=peer.express.attach,
        )

    async def _chores(self, peer: Peer) -> None:
        """Measure the clock of a gateway; ask a plain server for its topics."""
        while True:
            if peer.dialect is ROPEWAY:
                peer.ping()
                await asyncio.sleep(_CLOCK_S)
            elif self._watch and self._ask_rosapi:
                try:
                    await self.mirror.ask_rosapi(self.calls.plain)
                    self.spelling.seen(peer, [info.type for info in self.mirror.topics.values()])
                    if self._wants_calls:
                        await self.mirror.ask_calls(self.calls.plain)
                    self._rosapi_error = ""
                except GraphUnavailable as error:
                    self._rosapi_error = f"it does not answer what is asked of rosapi: {error.reason}"
                    log.debug("%s: %s", self.name, self._rosapi_error)
                    self.mirror.filled.set()
                await asyncio.sleep(_ROSAPI_S)
            else:
                self.mirror.filled.set()  # nobody will tell
                await self.spelling.find_out(peer)
                return

    @property
    def traffic(self) -> tuple[int, int]:
        """Bytes in and out over all connections."""
        live = self.peer.connection if self.peer is not None else None
        bytes_in, bytes_out = self._traffic
        return (bytes_in + live.bytes_in, bytes_out + live.bytes_out) if live is not None else self._traffic

    # ── the graph ──────────────────────────────────────────────────────────────────────────────────────────────

    async def create_publisher(
        self, topic: str, type: str, qos: QoS | None = None, *, delivery: Delivery = NO_HINTS
    ) -> RemotePublisher:
        """See ``Graph.create_publisher``; with the connection down it is announced when it is back."""
        self._check()
        name = resolve_name(topic)
        publisher = RemotePublisher(self, name, self.registry.canonical(type), qos or DEFAULT, delivery)
        self._publishers[publisher.number] = publisher
        self._note_echo(name)
        if self.peer is not None:
            try:
                publisher.connected(self.peer)
            except RopewayError:
                del self._publishers[publisher.number]
                raise
        return publisher

    async def create_subscription(
        self,
        topic: str,
        type: str,
        qos: QoS | None,
        callback: SampleCallback,
        *,
        delivery: Delivery = NO_HINTS,
    ) -> RemoteSubscription:
        """See ``Graph.create_subscription``; with the connection down it is asked for when it is back."""
        self._check()
        name = resolve_name(topic)
        subscription = RemoteSubscription(self, name, self.registry.canonical(type), qos, callback, delivery)
        self._subscriptions[subscription.number] = subscription
        self._note_echo(name)
        if self.peer is not None:
            subscription.connected(self.peer)
        return subscription

    async def create_client(self, service: str, type: str, *, delivery: Delivery = NO_HINTS) -> RemoteClient:
        """See ``Graph.create_client``."""
        self._check()
        client = RemoteClient(self.calls, resolve_name(service), self.registry.canonical(type, "srv"), delivery)
        self.calls.clients[client] = None
        return client

    async def create_service(
        self, service: str, type: str, handler: ServiceHandler, *, delivery: Delivery = NO_HINTS
    ) -> RemoteService:
        """See ``Graph.create_service``; with the connection down it is announced when it is back."""
        self._check()
        full = self.registry.canonical(type, "srv")
        made = RemoteService(self.calls, resolve_name(service), full, handler, delivery)
        self.calls.add(made, self.calls.services)
        return made

    async def create_action_client(
        self, action: str, type: str, *, delivery: Delivery = NO_HINTS
    ) -> RemoteActionClient:
        """See ``Graph.create_action_client``."""
        self._check()
        full = self.registry.canonical(type, "action")
        client = RemoteActionClient(self.calls, resolve_name(action), full, delivery)
        self.calls.clients[client] = None
        return client

    async def create_action_server(
        self, action: str, type: str, handlers: ActionHandlers, *, delivery: Delivery = NO_HINTS
    ) -> RemoteActionServer:
        """See ``Graph.create_action_server``; with the connection down it is announced when it is back."""
        self._check()
        full = self.registry.canonical(type, "action")
        made = RemoteActionServer(self.calls, resolve_name(action), full, handlers, delivery)
        self.calls.add(made, self.calls.servers)
        return made

    async def learn(self, type: str) -> bool:
        """See ``Learning.learn``."""
        return await self.teller.learn(type)

    def topics(self) -> dict[str, TopicInfo]:
        """Return what the far graph showed last; empty without ``watch`` or with the connection down."""
        return dict(self.mirror.topics)

    def look_up(self, kind: str, name: str) -> TopicInfo | ServiceInfo | ActionInfo | None:
        """See ``Graph.look_up``."""
        return self.mirror.topics.get(name) if kind == "topic" else super().look_up(kind, name)

    @property
    def untold(self) -> str:
        """See ``Telling.untold``."""
        if self.peer is None:
            return self.last_error or "it is not connected"
        return self._rosapi_error if self.mirror.filled.is_set() else "it has not told yet what there is"

    def services(self) -> dict[str, ServiceInfo]:
        """Return what the far graph showed last, and what is served from here; a plain server is polled from now on."""
        self._wants_calls = True
        ours = (ServiceInfo(s.name, (s.type,), (_US,)) for s in self.calls.services.values())
        return {s.name: s for s in ours} | self.mirror.services

    def actions(self) -> dict[str, ActionInfo]:
        """Return what the far graph showed last, and what is served from here; a plain server is polled from now on."""
        self._wants_calls = True
        ours = (ActionInfo(s.name, (s.type,), (_US,)) for s in self.calls.servers.values())
        return {s.name: s for s in ours} | self.mirror.actions

    def nodes(self) -> dict[str, NodeInfo]:
        """Return what the far graph showed last; empty without ``watch`` or with the connection down."""
        return dict(self.mirror.nodes)

    def _check(self) -> None:
        if not self._keeper.started or self.state is LinkState.CLOSED:
            raise GraphUnavailable(self.name, "is not open; call open() first")

    def parts(self) -> list[RemotePublisher | RemoteSubscription]:
        """Return the topics that are announced there."""
        return [*self._publishers.values(), *self._subscriptions.values()]

    def next_number(self) -> int:
        """Return a free channel number."""
        while True:
            number = next(self._numbers) % OP_CHANNELS.start
            if number and number not in self._publishers and number not in self._subscriptions:
                return number

    def forget(self, number: int, topic: str) -> None:
        """See ``LinkGraph.forget``."""
        self._publishers.pop(number, None)
        self._subscriptions.pop(number, None)
        self._note_echo(topic)

    def _note_echo(self, topic: str) -> None:
        published = any(p.topic == topic for p in self._publishers.values())
        read = any(s.topic == topic for s in self._subscriptions.values())
        if published and read:
            self.echoes.setdefault(topic, EchoFilter())
        else:
            self.echoes.pop(topic, None)

    def type_note(self, type: str) -> dict[str, Any]:
        """Return what a gateway should know of a type: its hash, and once per connection its definition."""
        if not self.registry.has(type):
            return {}
        note: dict[str, Any] = {"type_hash": self.registry.hash(type)}
        if type not in self._noted_types:
            self._noted_types.add(type)
            note["definition"] = self.registry.full_text(type)
        return note

    # ── what the peer says ─────────────────────────────────────────────────────────────────────────────────────

    def operation(self, op: ops.Op) -> None:
        """Handle a rosbridge operation."""
        if isinstance(op, ops.Publish):
            found = False
            for subscription in list(self._subscriptions.values()):
                if subscription.topic == op.topic:
                    found = True
                    subscription.published(op)
            if not found and self.peer is not None:
                self.peer.fault_log.note("unknown topic", op.topic, "it was not subscribed to")
        elif isinstance(op, ops.Png) and self.peer is not None:
            self.peer.unpacked(unpack_png(op.data, limit_bytes=self.peer.limit_bytes), Wrapping.IMAGE)
        elif self.peer is not None and not self.calls.operation(op, self.peer):
            self.peer.fault_log.note("operation", "", f"{op.op} is not for a client")

    def control(self, message: Mapping[str, Any]) -> None:
        """Handle a message of the Ropeway dialect."""
        op, number = message.get("op"), message.get("channel")
        publisher = self._publishers.get(number) if isinstance(number, int) else None
        subscription = self._subscriptions.get(number) if isinstance(number, int) else None
        if op == "hello":
            self.remote = {k: message[k] for k in ("gateway", "name", "version") if isinstance(message.get(k), str)}
            if self.peer is not None:
                self.calls.ready(self.peer)
        elif self.calls.control(message):
            return
        elif op == "demand" and publisher is not None and isinstance(message.get("count"), int):
            publisher.answers.tell("")
            publisher.set_subscribers(message["count"])
        elif op == "adopted" and subscription is not None:
            subscription.answers.tell("")
            if isinstance(message.get("qos"), Mapping):
                with contextlib.suppress(ValueError):
                    subscription.adopted(QoS.parse(message["qos"]))
            subscription.learned(message)
        elif op == "refused":
            self._was_refused(publisher or subscription, str(message.get("reason", "")))
        elif op == "stats" and publisher is not None:
            delay = message.get("delay_ms")
            publisher.remote_delay_s = delay / 1e3 if isinstance(delay, (int, float)) else None
        elif op == "graph":
            self.mirror.update(message)

    def _was_refused(self, part: RemotePublisher | RemoteSubscription | None, reason: str) -> None:
        if part is None or part.refused == reason:
            return
        if not part.answers.tell(reason):
            log.warning("%s: %s was refused: %s", self.name, part.topic, reason)

    def arrived(self, channel: int, arrivals: Sequence[Arrival]) -> None:
        """Deliver messages that came on a channel."""
        subscription = self._subscriptions.get(channel)
        if subscription is not None:
            subscription.arrived(arrivals)
        elif self.peer is not None:
            self.peer.fault_log.note("unknown topic", f"channel {channel}", "nobody subscribed to it")

    def takes(self, channel: int) -> bool:
        """Return whether somebody here reads a channel."""
        return channel in self._subscriptions

    def lost(self, code: int, reason: str) -> None:
        """Disconnect all parts: the connection is gone, and ``Reconnect`` makes the next one."""
