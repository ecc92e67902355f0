"""Shows viewers who publishes, reads and serves what: everything once, then what changes."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from collections.abc import Iterable

    from ropeway.graph.base import EndpointInfo
    from ropeway.graph.calls import ProviderInfo
    from ropeway.hub.hub import View
    from ropeway.listener.authorization import Access
    from ropeway.networks.foxglove.settings import FoxgloveSettings

__all__ = ["GraphState", "graph_state", "graph_update"]

GraphState = dict[str, dict[str, list[str]]]
"""By ``published``, ``subscribed`` and ``served``: the users of each name."""


def graph_state(view: View, settings: FoxgloveSettings, access: Access) -> GraphState:
    """Return who uses what, of all that a viewer may see."""
    topics = [
        info
        for name, info in view.hub.graph.topics().items()
        if settings.shows_topic(name) and access.sees("topics", name)
    ]
    services = [
        info
        for name, info in view.hub.graph.services().items()
        if settings.shows_service(name) and access.sees("services", name)
    ]
    return {
        "published": {info.name: _users(info.publishers) for info in topics if info.publishers},
        "subscribed": {info.name: _users(info.subscriptions) for info in topics if info.subscriptions},
        "served": {info.name: _users(info.servers) for info in services if info.servers},
    }


def _users(ends: Iterable[EndpointInfo] | Iterable[ProviderInfo]) -> list[str]:
    """Return the names of nodes, or what else there is to call a participant."""
    return sorted({end.node or end.gateway or end.gid.hex() or "unknown" for end in ends})


def graph_update(before: GraphState, now: GraphState) -> dict[str, Any] | None:
    """Return the operation that tells a change; ``None`` where there is none."""
    if before == now:
        return None
    topics_before = before["published"].keys() | before["subscribed"].keys()
    topics_now = now["published"].keys() | now["subscribed"].keys()
    return {
        "op": "connectionGraphUpdate",
        "publishedTopics": _changed(before["published"], now["published"], "publisherIds", topics_now),
        "subscribedTopics": _changed(before["subscribed"], now["subscribed"], "subscriberIds", topics_now),
        "advertisedServices": _changed(before["served"], now["served"], "providerIds", now["served"].keys()),
        "removedTopics": sorted(topics_before - topics_now),
        "removedServices": sorted(before["served"].keys() - now["served"].keys()),
    }


def _changed(
    before: dict[str, list[str]], now: dict[str, list[str]], users: str, there: Iterable[str]
) -> list[dict[str, Any]]:
    """Return the names whose users have changed; one without users that is still there has an empty list."""
    names = (name for name in sorted(there) if before.get(name, []) != now.get(name, []))
    return [{"name": name, users: now.get(name, [])} for name in names]
