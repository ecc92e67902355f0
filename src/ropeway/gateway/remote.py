"""Manages one remote of a running gateway: the graph on its side, the bridges to it, and their state."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, Final

from ropeway.bridge.action import ActionBridge
from ropeway.bridge.service import ServiceBridge
from ropeway.bridge.topic import TopicBridge
from ropeway.gateway.config.config import Route
from ropeway.gateway.config.model import RemoteConfig
from ropeway.gateway.credentials import Credentials
from ropeway.graph.base import Graph
from ropeway.graph.link_parts import Encoded, LinkedPublisher, LinkStatistics
from ropeway.listener.http import without_token
from ropeway.networks.rosbridge.client import RosbridgeGraph

if TYPE_CHECKING:
    from ropeway.gateway.automatic import Automatic
    from ropeway.networks.iort.graph import IortGraph
    from ropeway.networks.iort.links import RemoteLink
    from ropeway.networks.overlay.graph import OverlayGraph

__all__ = [
    "NO_CREDENTIALS",
    "Bridge",
    "IortRemote",
    "LinkRemote",
    "OverlayRemote",
    "Remote",
    "link_state",
    "link_status",
    "overlay_state",
    "shown_address",
]

Bridge = TopicBridge | ServiceBridge | ActionBridge


NO_CREDENTIALS: Final = Credentials()


class Remote:
    """A remote, whatever it is reached by."""

    graph: Graph

    def __init__(self, config: RemoteConfig, credentials: Credentials = NO_CREDENTIALS) -> None:
        self.config, self.credentials = config, credentials
        self.bridges: list[tuple[Route, Bridge]] = []

    @property
    def state(self) -> str:
        """The state in one word; ``connected`` while data can flow."""
        raise NotImplementedError

    def status(self) -> dict[str, Any]:
        """Return the state of the remote, for people and programs."""
        raise NotImplementedError

    def renew(self, credentials: Credentials) -> None:
        """Show and trust other credentials from the next connection on; at once, if others are trusted now."""
        anew, self.credentials = credentials.trusted != self.credentials.trusted, credentials
        self._renew(credentials, anew)

    def _renew(self, credentials: Credentials, anew: bool) -> None:
        """Hand new credentials on; with ``anew``, a connection that stands is made again."""

    def routes(self) -> list[dict[str, Any]]:
        """Return one row per bridge."""
        return [_route(route, bridge, self.state) for route, bridge in self.bridges]

    def topics(self) -> list[TopicBridge]:
        """Return the bridges that are metered."""
        return [bridge for _, bridge in self.bridges if isinstance(bridge, TopicBridge)]


class LinkRemote(Remote):
    """A gateway or a rosbridge server at an address."""

    def __init__(self, config: RemoteConfig, graph: RosbridgeGraph, credentials: Credentials) -> None:
        super().__init__(config, credentials)
        self.graph: RosbridgeGraph = graph

    def _renew(self, credentials: Credentials, anew: bool) -> None:
        self.graph.renew(credentials.context, credentials.headers, anew=anew)

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

    def routes(self) -> list[dict[str, Any]]:
        """Return one row per bridge, including those made automatically."""
        found = super().routes()
        if self.automatic is not None:
            found += [_route(route, bridge, self.state) for route, bridge in self.automatic.bridges()]
        return found

    def topics(self) -> list[TopicBridge]:
        """Return the bridges that are metered."""
        found = super().topics()
        if self.automatic is not None:
            found += [bridge for _, bridge in self.automatic.bridges()]
        return found


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


def _route(route: Route, bridge: Bridge, state: str) -> dict[str, Any]:
    """Return one row of the table of routes."""
    common = {
        "path": route.path,
        "operation": route.operation,
        "name": route.name,
        "remote_name": route.remote_name,
        "address": shown_address(route.remote),
        "type": route.type,
        "state": bridge.state if state == "connected" else state,
    }
    if isinstance(bridge, TopicBridge):
        return common | _topic(route, bridge)
    return common | {
        "error": bridge.error or (f"offered by {bridge.taken_by}" if bridge.taken_by else ""),
        "encoding": bridge.encoding,
        "requests": sum(bridge.counts.values()),
        "under_way": bridge.under_way,
        "ended": dict(bridge.counts),
        "took_ms": None if bridge.took_s is None else round(1e3 * bridge.took_s, 3),
    }


def _topic(route: Route, bridge: TopicBridge) -> dict[str, Any]:
    meter = bridge.meter
    drops: dict[str, int] = {reason.value: n for reason, n in bridge.drops.items() if n}
    delay, encoding = meter.delay_s, route.delivery.encoding
    publisher: object = bridge.publisher
    subscription: object = bridge.subscription
    link = publisher.statistics() if isinstance(publisher, LinkedPublisher) else LinkStatistics()
    if link.encoding is not None:
        encoding = link.encoding
    elif isinstance(subscription, Encoded):
        encoding = subscription.encoding
    drops.update(link.lost)
    if delay is None:
        delay = link.delay_s
    return {
        "error": bridge.error or link.refused,
        "encoding": encoding,
        "messages": meter.messages,
        "bytes": meter.bytes,
        "rate_hz": round(meter.rate_hz, 2),
        "bandwidth_bps": round(meter.rate_bps),
        "delay_ms": None if delay is None else round(1e3 * delay, 3),
        "drops": drops,
    }
