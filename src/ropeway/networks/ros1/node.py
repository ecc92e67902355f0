"""Implements a ROS 1 node on the network: its XML-RPC server, its TCPROS port, and the tables of its parts."""

from __future__ import annotations

import asyncio
import ipaddress
import logging
import os
import socket
from collections.abc import Callable, Sequence
from typing import Any, Final, Protocol

from ropeway.graph.base import new_origin
from ropeway.graph.host import Host
from ropeway.limits import ROS1_NEWCOMERS
from ropeway.networks.ros1.master import Master
from ropeway.networks.ros1.tcpros import TcprosConnection
from ropeway.networks.ros1.xmlrpc import XmlRpcClient, XmlRpcServer, split_uri, stop_listening
from ropeway.types.ros1_types import Ros1Types

__all__ = ["FirstSeenPublisher", "Ros1Node", "Target", "TopicFollower", "is_loopback", "our_host"]

log = logging.getLogger("ropeway.ros1")

_HEADER_S: Final = 5.0  # who connects has so long to say what it wants
_ORIGINS_LIMIT: Final = 16384
_OK: Final = 1
_ERROR: Final = -1


class Target(Protocol):
    """Serves what a peer that connected to us asks for: a published topic or a service."""

    ros1_name: str

    def accept(self, connection: TcprosConnection, fields: dict[str, str]) -> None:
        """Take over the connection, or ``refuse`` it."""


class TopicFollower(Protocol):
    """A topic that we read."""

    def update(self, uris: Sequence[str]) -> None:
        """Take the current list of the topic's publishers."""


class FirstSeenPublisher:
    """A publisher of ROS 1 as we saw it first, and the number of its last message here.

    Numbers are the times of arrival in nanoseconds, so that those of different publishers differ, too.
    """

    __slots__ = ("id", "seq")

    def __init__(self) -> None:
        self.id = new_origin()
        self.seq = 0

    def next(self, now_ns: int) -> int:
        """Return a number that was never given before."""
        self.seq = max(now_ns, self.seq + 1)
        return self.seq


class Ros1Node:
    """The node ``name`` of a graph. ``host`` is what others reach it by; both are known once it is open.

    ``epoch`` counts how often the master has forgotten us: what was connected before that may live on unregistered.
    """

    def __init__(self, graph: Host, name: str, uri: str, types: Ros1Types) -> None:
        self.graph, self.name, self.types = graph, name, types
        self.rpc = XmlRpcClient()
        self.master = Master(uri, self.rpc, name)
        self.host = ""
        self.uri = ""
        self.port = 0
        self.epoch = 0
        self.writers: dict[str, Target] = {}
        self.readers: dict[str, TopicFollower] = {}
        self.services: dict[str, Target] = {}
        self.on_update: Callable[[], None] = lambda: None
        self.on_shutdown: Callable[[str], None] = lambda reason: None
        self._server = XmlRpcServer(self._answer)
        self._tcp: asyncio.Server | None = None
        self._newcomers: dict[TcprosConnection, asyncio.TimerHandle] = {}
        self._origins: dict[tuple[str, str], FirstSeenPublisher] = {}

    async def open(self) -> None:
        """Start to listen. Raises ``OSError``."""
        loop = asyncio.get_running_loop()
        self.host = await our_host(split_uri(self.master.uri)[0])
        bind = self.host if is_loopback(self.host) else "0.0.0.0"  # noqa: S104  # as every ROS 1 node does
        await self._server.open(bind)
        self._tcp = await loop.create_server(lambda: TcprosConnection(self), bind, 0)
        self.port = self._tcp.sockets[0].getsockname()[1]
        self.uri = f"http://{self.host}:{self._server.port}/"

    @property
    def service_api(self) -> str:
        """The address at which our services are called."""
        return f"rosrpc://{self.host}:{self.port}"

    async def close(self) -> None:
        """Stop listening, and close what is still connected."""
        server, self._tcp = self._tcp, None
        if server is not None:
            await stop_listening(server)
        for connection in list(self._newcomers):
            connection.abort("the node has left")
        await self._server.close()
        await self.rpc.close()

    def origin(self, caller: str, topic: str) -> FirstSeenPublisher:
        """Return the identity of ``caller`` as a publisher of ``topic``."""
        found = self._origins.get((caller, topic))
        if found is None:
            if len(self._origins) >= _ORIGINS_LIMIT:
                del self._origins[next(iter(self._origins))]
            found = self._origins[caller, topic] = FirstSeenPublisher()
        return found

    # ── who connects to our TCPROS port ────────────────────────────────────────────────────────────────────────

    def made(self, connection: TcprosConnection) -> None:
        """Take the connection of a peer."""
        if self._tcp is None:
            connection.abort("the node has left")
            return
        if len(self._newcomers) >= ROS1_NEWCOMERS:
            oldest = next(iter(self._newcomers))
            self._greeted(oldest)
            oldest.abort("too many say nothing")
        timer = asyncio.get_running_loop().call_later(_HEADER_S, connection.abort, "no header came")
        self._newcomers[connection] = timer

    def header(self, connection: TcprosConnection, fields: dict[str, str]) -> None:
        """Read what a peer that connected wants; see ``tcpros.Receiver``."""
        self._greeted(connection)
        topic, service = fields.get("topic"), fields.get("service")
        target = self.services.get(service or "") if topic is None else self.writers.get(topic)
        if target is not None:
            target.accept(connection, fields)
        elif topic is None and service is None:
            connection.refuse("the header names neither a topic nor a service")
        else:
            what = f"service {service}" if topic is None else f"topic {topic}"
            connection.refuse(f"[{self.name}] has no {what}")

    def frames(self, connection: TcprosConnection, frames: Sequence[bytes]) -> None:
        """Ignore the frames of a peer that was refused; see ``tcpros.Receiver``."""

    def lost(self, connection: TcprosConnection) -> None:
        """See ``tcpros.Receiver``."""
        self._greeted(connection)

    def writable(self, connection: TcprosConnection) -> None:
        """See ``tcpros.Receiver``."""

    def _greeted(self, connection: TcprosConnection) -> None:
        timer = self._newcomers.pop(connection, None)
        if timer is not None:
            timer.cancel()

    # ── the API that the master and other nodes call ───────────────────────────────────────────────────────────

    async def _answer(self, method: str, params: tuple[Any, ...]) -> Any:
        match method, params:
            case "requestTopic", (_, str(topic), list(protocols)):
                return self._request_topic(topic, protocols)
            case "publisherUpdate", (_, str(topic), list(uris)):
                source = self.readers.get(topic)
                self.on_update()
                if source is None:
                    return [_ERROR, f"{topic} is not read here", 0]
                source.update([uri for uri in uris if isinstance(uri, str)])
                return [_OK, "", 0]
            case "getPid", (_,):
                return [_OK, "", os.getpid()]
            case "getMasterUri", (_,):
                return [_OK, "", self.master.uri]
            case "getPublications", (_,):
                return [_OK, "", self._listed(self.writers)]
            case "getSubscriptions", (_,):
                return [_OK, "", self._listed(self.readers)]
            case "getBusInfo", (_,):
                return [_OK, "", []]
            case "getBusStats", (_,):
                return [_OK, "", [[], [], []]]
            case "paramUpdate", (_, str(), _):
                return [_OK, "", 0]
            case "shutdown", (_, *reason):
                self.on_shutdown(str(reason[0]) if reason else "")
                return [_OK, "", 0]
        return [_ERROR, f"{method} with {len(params)} parameters of these types is not known", 0]

    def _request_topic(self, topic: str, protocols: list[Any]) -> Any:
        if topic not in self.writers:
            return [_ERROR, f"{topic} is not published here", 0]
        if not any(isinstance(offer, list) and offer[:1] == ["TCPROS"] for offer in protocols):
            return [0, "only TCPROS is spoken here", 0]
        return [_OK, f"ready on {self.host}:{self.port}", ["TCPROS", self.host, self.port]]

    def _listed(self, parts: dict[str, Any]) -> list[list[str]]:
        return [[topic, part.ros1_name] for topic, part in parts.items()]


def is_loopback(host: str) -> bool:
    """Return whether ``host`` is ``localhost`` or an address of the loopback interface."""
    if host == "localhost":
        return True
    try:
        return ipaddress.ip_address(host).is_loopback
    except ValueError:
        return False


async def our_host(master: str) -> str:
    """Return the name by which others reach us: ``ROS_HOSTNAME``, ``ROS_IP``, or the address from which we reach the
    master.
    """
    named = os.environ.get("ROS_HOSTNAME", "") or os.environ.get("ROS_IP", "")
    if named:
        return named
    if is_loopback(master):
        return "127.0.0.1"
    found = await asyncio.get_running_loop().getaddrinfo(master, 9, type=socket.SOCK_DGRAM)
    family, kind, protocol, _, address = found[0]
    with socket.socket(family, kind, protocol) as probe:
        probe.connect(address)  # a datagram socket: nothing is sent, only the route is looked up
        return str(probe.getsockname()[0])
