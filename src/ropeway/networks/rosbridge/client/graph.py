"""The client role: a connection to a rosbridge server or gateway that reconnects and restores everything on it."""

from __future__ import annotations

import contextlib
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
from ropeway.networks.rosbridge.client.link_chores import LinkChores
from ropeway.networks.rosbridge.client.mirror import RemoteMirror
from ropeway.networks.rosbridge.client.parts import RemotePublisher, RemoteSubscription
from ropeway.networks.rosbridge.client.plain_servers import PlainServer
from ropeway.networks.rosbridge.client.reconnect import LinkState, Reconnect
from ropeway.networks.rosbridge.client.refusals import answer_invalid
from ropeway.networks.rosbridge.client.ros1_spelling import Spelling
from ropeway.networks.rosbridge.client.second_connection import keep_second
from ropeway.networks.rosbridge.client.servers import RemoteActionServer
from ropeway.networks.rosbridge.client.services import RemoteClient, RemoteService
from ropeway.networks.rosbridge.client.topic_table import TopicTable
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

_US: Final = ProviderInfo(local=True)


class RosbridgeGraph(GraphBase):
    """The graph behind ``url`` (``ws://`` or ``wss://``).

    With ``wait`` true ``open`` returns when connected, or raises ``ConnectFailed``; with false it returns at once
    and the connection is made in the background. Either way a lost connection is made again, for ever, and every
    publisher, subscription, service and action is announced again. ``watch`` asks the far side what it has: a
    gateway tells, a plain server is asked through rosapi (unless ``ask_rosapi`` is false). ``plain`` speaks
    rosbridge even to a gateway. ``ros1`` tells whether a plain server is one of ROS 1; left out, it is found out.
    ``network`` has the types of the far side where they are known not to be those of ``registry``. ``dial`` connects.
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
        dial: Callable[..., Awaitable[Connection]] = connect,
    ) -> None:
        self._dial = partial(dial, url)
        super().__init__(shown := without_token(url))
        ours = registry or TypeRegistry()
        self.registry = network or ours
        self.border = Border(ours, network)
        self.peer: Peer | None = None
        self.remote: dict[str, Any] = {}
        self.connections = 0
        self._ssl = ssl_context
        self._headers = headers
        self.gateway_id, self._node_name = gateway_id, name
        self._wait, self._watch, self._plain = wait, watch, plain
        self.table = TopicTable(shown)
        self.calls: Calls = Calls(self)
        self.mirror = RemoteMirror(shown, self._changes, self.calls.changed)
        self._keeper = Reconnect(shown, limits or Limits(), self._connect)
        self._noted_types: set[str] = set()
        self.plain_server = PlainServer(shown, self.registry)
        self.spelling = Spelling(self, ros1)
        self.one_of_several = False
        self.teller = RemoteDefinitions(self)
        self._traffic = (0, 0)
        self._chores = LinkChores(self, asks=watch and ask_rosapi)

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
        for part in self.table.parts():
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

    def begin_watch(self) -> None:
        """Ask the far side from now on what it has."""
        began, self._watch = not self._watch, True
        if began and self.peer is not None and self.peer.dialect is ROPEWAY:
            self.peer.send({"op": "watch"})

    def renew(self, ssl_context: ssl.SSLContext | None, headers: Mapping[str, str], *, anew: bool) -> None:
        """Show and trust other credentials from the next connection on; with ``anew`` that is made at once."""
        self._ssl, self._headers = ssl_context, dict(headers)
        if anew and self.peer is not None:
            self.peer.connection.close(1000, "certificates were read again")

    async def _connect(self, limits: Limits) -> Callable[[], Awaitable[None]]:
        peers: list[Peer] = []
        connection = await self._dial(
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
        self.table.connected(peer)
        for provider in self.calls.providers():
            try:
                provider.connected(peer)
            except RopewayError as error:
                provider.held.tell(str(error))
        if peer.dialect is not ROPEWAY or peer.greeted:
            self.calls.ready(peer)
        self._keeper.set_state(LinkState.CONNECTED)
        chores = Supervised(partial(self._chores.run, peer), f"chores {self.name}").start()
        second = Supervised(partial(keep_second, peer, self._second), f"second connection {self.name}").start()
        types = Supervised(self.teller.follow, f"definitions from {self.name}").start()
        try:
            code, reason = await connection.wait_closed()
        finally:
            await end(second, chores, types)
            self._traffic = (self._traffic[0] + connection.bytes_in, self._traffic[1] + connection.bytes_out)
            self._keeper.rtt_s = peer.rtt_s or 0.0
            self.peer = None
            self.plain_server.ended(peer, self.table.channels, time.monotonic() - began)
            self.table.disconnected()
            self.calls.disconnected()
            self.mirror.clear()
        if not self._keeper.leaving:
            log.warning("%s: disconnected (%d %s)", self.name, code, reason)

    async def _second(self, peer: Peer) -> Connection:
        """Open a second connection beside the one of ``peer``. Raises ``ConnectFailed``."""
        return await self._dial(
            limits=self._keeper.limits,
            subprotocols=(ROPEWAY_SUBPROTOCOL,),
            ssl_context=self._ssl,
            headers={**(self._headers or {}), EXPRESS_HEADER: peer.express.offered},
            on_connection=peer.express.attach,
        )

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
        self.table.add_publisher(publisher, self.peer)
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
        self.table.add_subscription(subscription, self.peer)
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
        return self._chores.error if self.mirror.filled.is_set() else "it has not told yet what there is"

    def services(self) -> dict[str, ServiceInfo]:
        """Return what the far graph showed last, and what is served from here; a plain server is polled from now on."""
        self._chores.wants_calls = True
        ours = (ServiceInfo(s.name, (s.type,), (_US,)) for s in self.calls.services.values())
        return {s.name: s for s in ours} | self.mirror.services

    def actions(self) -> dict[str, ActionInfo]:
        """Return what the far graph showed last, and what is served from here; a plain server is polled from now on."""
        self._chores.wants_calls = True
        ours = (ActionInfo(s.name, (s.type,), (_US,)) for s in self.calls.servers.values())
        return {s.name: s for s in ours} | self.mirror.actions

    def nodes(self) -> dict[str, NodeInfo]:
        """Return what the far graph showed last; empty without ``watch`` or with the connection down."""
        return dict(self.mirror.nodes)

    def _check(self) -> None:
        if not self._keeper.started or self.state is LinkState.CLOSED:
            raise GraphUnavailable(self.name, "is not open; call open() first")

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
        peer = self.peer
        if peer is None:
            return
        if isinstance(op, ops.Publish):
            self.table.published(op, peer)
        elif isinstance(op, ops.Png):
            peer.unpacked(unpack_png(op.data, limit_bytes=peer.limit_bytes), Wrapping.IMAGE)
        elif not self.calls.operation(op, peer):
            peer.fault_log.note("operation", "", f"{op.op} is not for a client")

    def control(self, message: Mapping[str, Any]) -> None:
        """Handle a message of the Ropeway dialect."""
        op = message.get("op")
        if op == "hello":
            self.remote = {k: message[k] for k in ("gateway", "name", "version") if isinstance(message.get(k), str)}
            if self.peer is not None:
                self.calls.ready(self.peer)
        elif op == "graph":
            self.mirror.update(message)
        elif not self.calls.control(message):
            self.table.control(message)

    def arrived(self, channel: int, arrivals: Sequence[Arrival]) -> None:
        """Deliver messages that came on a channel."""
        if self.peer is not None:
            self.table.arrived(channel, arrivals, self.peer)

    def takes(self, channel: int) -> bool:
        """Return whether somebody here reads a channel."""
        return self.table.takes(channel)

    def lost(self, code: int, reason: str) -> None:
        """Disconnect all parts: the connection is gone, and ``Reconnect`` makes the next one."""
