"""The graph of a ROS 1 master and its nodes, as one more node that needs no ROS installation."""

from __future__ import annotations

import contextlib
import logging
import secrets
from typing import Any, Final

from ropeway.errors import ConnectFailed, GraphUnavailable, TypeConflict
from ropeway.graph.base import (
    NO_HINTS,
    Delivery,
    NodeInfo,
    SampleCallback,
    TopicInfo,
    resolve_name,
)
from ropeway.graph.calls import ActionHandlers, ActionInfo, ProviderInfo, ServiceHandler, ServiceInfo
from ropeway.graph.graph_base import NetworkGraph
from ropeway.networks.ros1.action_client import Ros1ActionClient
from ropeway.networks.ros1.action_server import Ros1ActionServer
from ropeway.networks.ros1.client import Ros1Client
from ropeway.networks.ros1.master import Master, MasterRefused, master_uri, slave_call
from ropeway.networks.ros1.master_registration import MasterRegistration
from ropeway.networks.ros1.node import Ros1Node
from ropeway.networks.ros1.reader import reader_of
from ropeway.networks.ros1.service import Ros1Service, ServiceDoor
from ropeway.networks.ros1.subscription import Ros1Subscription
from ropeway.networks.ros1.writer import Ros1Publisher, writer_of
from ropeway.qos import DEFAULT, QoS
from ropeway.types import TypeRegistry
from ropeway.types.ros1_spelling import Ros1Spelling
from ropeway.types.ros1_types import Ros1Types

__all__ = ["Ros1Graph"]

log = logging.getLogger("ropeway.ros1")

_POLL_S: Final = 1.0
_ALIVE_S: Final = 1.0
_US: Final = (ProviderInfo(local=True),)


class Ros1Graph(NetworkGraph):
    """The ROS 1 network of the master at ``uri`` (``http://host:port``; left out: ``ROS_MASTER_URI``).

    ``name`` is the node's name; where a living node has it already, a few letters are added. ``poll_s``: how often
    the master is asked what has changed. What ROS 1 cannot say: of quality of service it knows whether a topic is
    latched, and that only once it is read.
    """

    kind = "ros1"

    def __init__(
        self, uri: str = "", *, registry: TypeRegistry | None = None, name: str = "ropeway", poll_s: float = _POLL_S
    ) -> None:
        self.uri = master_uri(uri)
        super().__init__(f"ros1:{self.uri}")
        self.registry = registry or TypeRegistry()
        self._node_name = resolve_name(name, "/")
        self._poll_s = poll_s
        self._types = Ros1Types(self.registry)
        self._spelling = Ros1Spelling(self._types)
        self._node: Ros1Node | None = None
        self._keeper: MasterRegistration | None = None

    @property
    def ros1_spelling(self) -> Ros1Spelling:
        """The spelling of this network's messages for rosbridge clients."""
        return self._spelling

    async def _join(self) -> None:
        node = Ros1Node(self, self._node_name, self.uri, self._types)
        keeper = MasterRegistration(node, self._changes, self._poll_s)
        try:
            await node.open()
            await self._find_name(node)
            await keeper.start()
        except (ConnectFailed, MasterRefused, OSError, ValueError) as error:
            await node.close()
            what = "start roscore there, or set ROS_MASTER_URI to where it runs"
            raise GraphUnavailable(self.name, f"the ROS 1 master does not answer ({error}); {what}") from None
        self._node, self._keeper = node, keeper
        log.info("%s: joined as %s, reached at %s", self.name, node.name, node.uri)

    async def _find_name(self, node: Ros1Node) -> None:
        """Take another name where a living node has ours: the master would end it."""
        other = await node.master.lookup_node(node.name)
        if not other:
            return
        with contextlib.suppress(ConnectFailed, MasterRefused):
            await slave_call(node.rpc, other, "getPid", node.name, timeout_s=_ALIVE_S)
            node.name = node.master.caller = f"{node.name}_{secrets.token_hex(2)}"

    async def _close_parts(self) -> None:
        if self._keeper is not None:
            await self._keeper.stop()
        await super()._close_parts()

    async def _leave(self) -> None:
        node, self._node, self._keeper = self._node, None, None
        if node is not None:
            await node.close()

    @property
    def node(self) -> str:
        """The name of our node."""
        return self._node_name if self._node is None else self._node.name

    @property
    def up(self) -> bool:
        """Whether the master answers."""
        return self._keeper is not None and self._keeper.up

    def _opened(self) -> tuple[Ros1Node, MasterRegistration]:
        self._check_open()
        assert self._node is not None and self._keeper is not None
        return self._node, self._keeper

    # ── topics ─────────────────────────────────────────────────────────────────────────────────────────────────

    async def create_publisher(
        self, topic: str, type: str, qos: QoS | None = None, *, delivery: Delivery = NO_HINTS
    ) -> Ros1Publisher:
        """Publish ``topic``, latched where ``qos`` is transient local; ``delivery`` has no meaning here."""
        node, keeper = self._opened()
        name = resolve_name(topic)
        full = self.registry.canonical(type)
        converter = self._types.converter(full)
        writer = writer_of(node, name, self._types.message(full))
        publisher = Ros1Publisher(writer, full, qos or DEFAULT, converter)
        self._parts.add(publisher)
        if not writer.registered:
            await keeper.register(writer)
        return publisher

    async def create_subscription(
        self,
        topic: str,
        type: str,
        qos: QoS | None,
        callback: SampleCallback,
        *,
        delivery: Delivery = NO_HINTS,
    ) -> Ros1Subscription:
        """Read ``topic``. A type that is not known here is learned from the first publisher."""
        node, keeper = self._opened()
        reader = reader_of(node, resolve_name(topic), self.registry.canonical(type))
        subscription = Ros1Subscription(reader, qos, callback)
        self._parts.add(subscription)
        if not reader.registered:
            await keeper.register(reader)
        return subscription

    # ── services and actions ───────────────────────────────────────────────────────────────────────────────────

    async def create_client(self, service: str, type: str, *, delivery: Delivery = NO_HINTS) -> Ros1Client:
        """Call ``service``; ``delivery`` has no meaning here."""
        node, keeper = self._opened()
        name, full = resolve_name(service), self.registry.canonical(type, "srv")
        request, response = (self._types.converter(f"{full}{end}") for end in ("_Request", "_Response"))
        client = Ros1Client(node, keeper, name, full, request, response)
        self._parts.add(client)
        return client

    async def create_service(
        self, service: str, type: str, handler: ServiceHandler, *, delivery: Delivery = NO_HINTS
    ) -> Ros1Service:
        """Serve ``service``; another node that served it is not called any more. ``delivery`` has no meaning here."""
        node, keeper = self._opened()
        name, full = resolve_name(service), self.registry.canonical(type, "srv")
        request, response = (self._types.converter(f"{full}{end}") for end in ("_Request", "_Response"))
        door = node.services.get(name)
        if door is None:
            door = node.services[name] = ServiceDoor(node, name)
        assert isinstance(door, ServiceDoor)
        if door.services and door.services[0].type != full:
            raise TypeConflict(name, door.services[0].type, full)
        made = Ros1Service(door, full, request, response, handler)
        self._parts.add(made)
        if not door.registered:
            await keeper.register(door)
        return made

    async def create_action_client(self, action: str, type: str, *, delivery: Delivery = NO_HINTS) -> Ros1ActionClient:
        """Use ``action``; ``delivery`` has no meaning here."""
        _, keeper = self._opened()
        client = Ros1ActionClient(keeper, resolve_name(action), self.registry.canonical(type, "action"))
        self._parts.add(client)
        await client.open()
        return client

    async def create_action_server(
        self, action: str, type: str, handlers: ActionHandlers, *, delivery: Delivery = NO_HINTS
    ) -> Ros1ActionServer:
        """Serve ``action``; ``delivery`` has no meaning here."""
        _, keeper = self._opened()
        server = Ros1ActionServer(keeper, resolve_name(action), self.registry.canonical(type, "action"), handlers)
        self._parts.add(server)
        await server.open()
        return server

    # ── what is there ──────────────────────────────────────────────────────────────────────────────────────────

    def topics(self) -> dict[str, TopicInfo]:
        """Return what the master showed last; the topics that belong to actions stand under ``actions``."""
        return {} if self._keeper is None else self._keeper.picture.topics()

    def services(self) -> dict[str, ServiceInfo]:
        """Return what the master showed last, and what is served from here."""
        if self._node is None or self._keeper is None:
            return {}
        shown = self._keeper.picture.services()
        for name, door in self._node.services.items():
            if isinstance(door, ServiceDoor) and door.services and not any(s.local for s in _servers(shown, name)):
                shown[name] = ServiceInfo(name, (door.services[0].type,), (*_servers(shown, name), *_US))
        return shown

    def actions(self) -> dict[str, ActionInfo]:
        """Return what the master showed last, and what is served from here."""
        if self._keeper is None:
            return {}
        shown = self._keeper.picture.actions()
        for part in self._parts:
            if isinstance(part, Ros1ActionServer):
                there = shown[part.action].servers if part.action in shown else ()
                if not any(server.local for server in there):
                    shown[part.action] = ActionInfo(part.action, (part.type,), (*there, *_US))
        return shown

    def nodes(self) -> dict[str, NodeInfo]:
        """Return all nodes that have a topic or a service, as the master showed last."""
        return {} if self._keeper is None else self._keeper.picture.nodes()

    # ── the parameter server ───────────────────────────────────────────────────────────────────────────────────

    def _master(self) -> Master:
        return self._opened()[0].master

    async def get_param(self, name: str) -> Any:
        """Return a parameter, or a namespace of them as a dict.

        Raises ``KeyError`` if there is none. This and the other methods for parameters raise ``ConnectFailed`` if
        the master does not answer.
        """
        return await self._master().get_param(resolve_name(name) if name != "/" else name)

    async def set_param(self, name: str, value: Any) -> None:
        """Set a parameter, or all of a namespace from a dict. Raises ``ValueError`` for what XML-RPC cannot write."""
        await self._master().set_param(resolve_name(name), value)

    async def delete_param(self, name: str) -> None:
        """Delete a parameter or a namespace. Raises ``KeyError`` if there is none."""
        await self._master().delete_param(resolve_name(name))

    async def list_params(self) -> list[str]:
        """Return the names of all parameters, sorted."""
        return await self._master().list_params()


def _servers(shown: dict[str, ServiceInfo], name: str) -> tuple[ProviderInfo, ...]:
    return shown[name].servers if name in shown else ()
