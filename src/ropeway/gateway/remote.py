"""Manages one remote of a running gateway: the graph on its side, the bridges to it, and their state."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from contextlib import AsyncExitStack
from typing import TYPE_CHECKING, Any, Final

from ropeway import aio
from ropeway.bridge.topic import TopicBridge
from ropeway.errors import RopewayError
from ropeway.gateway.config.model import RemoteConfig
from ropeway.gateway.credentials import Credentials
from ropeway.gateway.route import RouteStatus, RunningRoute
from ropeway.graph.base import Graph
from ropeway.listener.http import without_token
from ropeway.networks.rosbridge.client import RosbridgeGraph

if TYPE_CHECKING:
    from ropeway.gateway.automatic import Automatic
    from ropeway.networks.iort.graph import IortGraph
    from ropeway.networks.iort.links import RemoteLink
    from ropeway.networks.mqtt.graph import MqttGraph
    from ropeway.networks.overlay.graph import OverlayGraph

__all__ = [
    "NO_CREDENTIALS",
    "IortRemote",
    "LinkRemote",
    "MqttRemote",
    "OverlayRemote",
    "Remote",
    "SeveralLinks",
    "link_state",
    "link_status",
    "overlay_state",
    "shown_address",
]


_LOOK_S: Final = 2.0  # somebody waits for an explanation

NO_CREDENTIALS: Final = Credentials()


class Remote:
    """A remote, whatever it is reached by."""

    graph: Graph
    listens = False
    """Whether ``listen`` wants a view of the local graph, and ``close`` is to be called."""

    def __init__(self, config: RemoteConfig, credentials: Credentials = NO_CREDENTIALS) -> None:
        self.config, self.credentials = config, credentials
        self.running: dict[str, RunningRoute] = {}  # by the keys of routes

    @property
    def state(self) -> str:
        """The state in one word; ``connected`` while data can flow."""
        raise NotImplementedError

    def status(self) -> dict[str, Any]:
        """Return the state of the remote, for people and programs."""
        raise NotImplementedError

    def on_state(self, callback: Callable[[], None]) -> None:
        """Call ``callback`` whenever the state may have changed, where the link tells."""

    def begin_watch(self) -> None:
        """See that what the far side offers is known from now on."""

    async def crosses(self, config: RemoteConfig) -> None:
        """Take over what is about to cross by ``config``, before routes of it start."""

    async def listen(self, view: Graph) -> None:
        """Begin what the remote reads of the local graph for itself."""

    async def close(self) -> None:
        """End it."""

    def renew(self, credentials: Credentials) -> None:
        """Show and trust other credentials from the next connection on; at once, if others are trusted now."""
        anew, self.credentials = credentials.trusted != self.credentials.trusted, credentials
        self._renew(credentials, anew)

    def _renew(self, credentials: Credentials, anew: bool) -> None:
        """Hand new credentials on; with ``anew``, a connection that stands is made again."""

    def joined(self) -> list[RunningRoute]:
        """Return every route with its bridge."""
        return list(self.running.values())

    def routes(self) -> list[RouteStatus]:
        """Return how every route is."""
        state = self.state
        return [running.status(state) for running in self.joined()]

    def topics(self) -> list[TopicBridge]:
        """Return the bridges that are metered."""
        return [running.bridge for running in self.joined() if isinstance(running.bridge, TopicBridge)]

    async def look(self, stack: AsyncExitStack) -> Graph | None:
        """Return a graph that shows what the remote has, open as long as ``stack``; ``None`` where ours shows it."""
        return None


class LinkRemote(Remote):
    """A gateway or a rosbridge server at an address."""

    def __init__(
        self,
        config: RemoteConfig,
        graph: RosbridgeGraph,
        credentials: Credentials,
        *,
        make_onlooker: Callable[[], RosbridgeGraph] | None = None,
    ) -> None:
        super().__init__(config, credentials)
        self.graph: RosbridgeGraph = graph
        self._make_onlooker = make_onlooker

    def on_state(self, callback: Callable[[], None]) -> None:
        """See ``Remote.on_state``."""
        self.graph.on_state(lambda _: callback())

    def begin_watch(self) -> None:
        """See ``Remote.begin_watch``."""
        self.graph.begin_watch()

    def _renew(self, credentials: Credentials, anew: bool) -> None:
        self.graph.renew(credentials.context, credentials.headers, anew=anew)

    async def look(self, stack: AsyncExitStack) -> Graph | None:
        """See ``Remote.look``: a connection of its own is told what is there, as far as the remote lets us see it."""
        if self._make_onlooker is None:
            return None
        onlooker = self._make_onlooker()
        stack.push_async_callback(onlooker.close)
        try:
            async with aio.timeout(_LOOK_S):
                await onlooker.open()
        except (RopewayError, TimeoutError):
            return None
        return onlooker

    @property
    def state(self) -> str:
        """The state in one word; ``connected`` while data can flow."""
        return link_state(self.graph)

    def status(self) -> dict[str, Any]:
        """Return the state of the link, for people and programs."""
        return {
            "address": shown_address(self.config),
            "title": self.config.title,
            **link_status(self.graph),
        }


class IortRemote(Remote):
    """A server of IoRT nodes at an address."""

    def __init__(self, config: RemoteConfig, graph: IortGraph, link: RemoteLink, credentials: Credentials) -> None:
        super().__init__(config, credentials)
        self.graph: IortGraph = graph
        self.link = link

    def _renew(self, credentials: Credentials, anew: bool) -> None:
        self.link.node.renew(credentials.token, credentials.context, anew=anew)

    @property
    def state(self) -> str:
        """The state in one word; ``connected`` while data can flow."""
        return "connected" if self.link.connected else "connecting"

    def status(self) -> dict[str, Any]:
        """Return the state of the link, for people and programs."""
        return {
            "address": shown_address(self.config),
            "title": self.config.title,
            "state": self.state,
            "error": "" if self.link.connected else self.link.node.last_error,
            "pending": self.link.node.pending,
            "superseded": self.link.node.superseded,
            "refused": dict(self.link.node.refused),
            "faults": self.link.node.faults,
            "drops": {f"{topic}: {why.value}": n for (topic, why), n in self.graph.drops.items() if n},
        }


class MqttRemote(Remote):
    """An MQTT broker at an address."""

    def __init__(self, config: RemoteConfig, graph: MqttGraph, credentials: Credentials) -> None:
        super().__init__(config, credentials)
        self.graph: MqttGraph = graph

    def _renew(self, credentials: Credentials, anew: bool) -> None:
        self.graph.renew(credentials.password, credentials.context, anew=anew)

    @property
    def state(self) -> str:
        """The state in one word; ``connected`` while data can flow."""
        return "connected" if self.graph.connected else "connecting"

    def status(self) -> dict[str, Any]:
        """Return the state of the link, for people and programs."""
        return {
            "address": shown_address(self.config),
            "title": self.config.title,
            "state": self.state,
            **self.graph.status(),
        }


class OverlayRemote(Remote):
    """The remote that stands for all members of the overlay."""

    def __init__(self, config: RemoteConfig, graph: OverlayGraph) -> None:
        super().__init__(config)
        self.graph: OverlayGraph = graph
        self.automatic: Automatic | None = None

    @property
    def state(self) -> str:
        """The state in one word; ``connected`` while a router or another member is linked with us."""
        return overlay_state(self.graph)

    def status(self) -> dict[str, Any]:
        """Return the state of the overlay as this member sees it."""
        return {
            "address": shown_address(self.config),
            "title": self.config.title,
            "state": self.state,
            "error": self.graph.node.trouble or self.graph.node.links.unlinked,
            "overlay": self.graph.node.status(),
            **({} if self.automatic is None else {"automatic": self.automatic.status()}),
        }

    def joined(self) -> list[RunningRoute]:
        """Return every route with its bridge, including those made automatically."""
        made = [] if self.automatic is None else self.automatic.bridges()
        return super().joined() + [RunningRoute(*pair) for pair in made]


def shown_address(config: RemoteConfig) -> str:
    """Return the address of a remote without secrets; of a group all of them."""
    return ",".join(map(without_token, config.addresses))


def link_state(graph: RosbridgeGraph) -> str:
    """Return how a link is, in one word; ``connected`` where data can flow."""
    return graph.state.value


def overlay_state(graph: OverlayGraph) -> str:
    """Return how the overlay is, in one word; ``connected`` where data can flow."""
    return "failed" if graph.node.trouble else "connected" if graph.node.fabric.links() else "connecting"


def link_status(graph: RosbridgeGraph) -> dict[str, Any]:
    """Return a link as it stands, as JSON."""
    peer = graph.peer
    bytes_in, bytes_out = graph.traffic
    pace = peer.connection.flow.pace.bytes_per_s if peer is not None else None
    return {
        "state": link_state(graph),
        "error": graph.last_error,
        "gateway": graph.remote.get("name", ""),
        "connections": graph.connections,
        "rtt_ms": None if peer is None or peer.rtt_s is None else round(1e3 * peer.rtt_s, 3),
        "pace_bps": None if pace is None else round(8 * pace),
        "bytes_in": bytes_in,
        "bytes_out": bytes_out,
        "complaints": {}
        if peer is None
        else {f"{kind} {topic}".strip(): n for (kind, topic), n in peer.fault_log.counts.items()},
    }


class SeveralLinks(Remote):
    """The base of remotes that several links lead to; ``links`` has them by name."""

    links: Mapping[str, RosbridgeGraph]

    def begin_watch(self) -> None:
        """See ``Remote.begin_watch``."""
        for link in self.links.values():
            link.begin_watch()

    def _renew(self, credentials: Credentials, anew: bool) -> None:
        for link in self.links.values():
            link.renew(credentials.context, credentials.headers, anew=anew)

    @property
    def state(self) -> str:
        """The state in one word; ``connected`` while a link is up."""
        states = [link_state(link) for link in self.links.values()]
        return "connected" if "connected" in states else states[0]

    @property
    def error(self) -> str:
        """The last errors of links that are not up."""
        return "; ".join(f"{name}: {link.last_error}" for name, link in self.links.items() if link.last_error)

    def members(self, named: str) -> list[dict[str, Any]]:
        """Return each link as it stands, as JSON, with its name under the key ``named``."""
        return [{named: name, **link_status(link)} for name, link in self.links.items()]
