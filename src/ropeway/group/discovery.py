"""Brings together what is discovered on several graphs."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from typing import TypeVar

from ropeway.graph.base import Graph, TopicInfo
from ropeway.graph.calls import ActionInfo, ServiceInfo

__all__ = ["all_actions", "all_services", "all_topics"]

T = TypeVar("T")


def all_topics(graphs: Sequence[Graph]) -> dict[str, TopicInfo]:
    """Return the topics of any of the graphs."""
    return {
        name: TopicInfo(name, _types(infos), _all(i.publishers for i in infos), _all(i.subscriptions for i in infos))
        for name, infos in _on_each(graphs, lambda graph: graph.topics()).items()
    }


def all_services(graphs: Sequence[Graph]) -> dict[str, ServiceInfo]:
    """Return the services of any of the graphs."""
    return {
        name: ServiceInfo(name, _types(infos), _all(i.servers for i in infos), _all(i.clients for i in infos))
        for name, infos in _on_each(graphs, lambda graph: graph.services()).items()
    }


def all_actions(graphs: Sequence[Graph]) -> dict[str, ActionInfo]:
    """Return the actions of any of the graphs."""
    return {
        name: ActionInfo(name, _types(infos), _all(i.servers for i in infos), _all(i.clients for i in infos))
        for name, infos in _on_each(graphs, lambda graph: graph.actions()).items()
    }


def _on_each(graphs: Sequence[Graph], look: Callable[[Graph], Mapping[str, T]]) -> dict[str, list[T]]:
    """Return what ``look`` finds on each graph, by name."""
    found: dict[str, list[T]] = {}
    for graph in graphs:
        for name, info in look(graph).items():
            found.setdefault(name, []).append(info)
    return found


def _types(infos: Sequence[TopicInfo | ServiceInfo | ActionInfo]) -> tuple[str, ...]:
    return tuple(dict.fromkeys(type for info in infos for type in info.types))


def _all(many: Iterable[Iterable[T]]) -> tuple[T, ...]:
    return tuple(dict.fromkeys(one for some in many for one in some))
