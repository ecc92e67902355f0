"""Presents a graph as rosapi does: names and types by the rules of the original.

Hidden names are left out: topics and services with a part that begins with ``_``, and nodes whose last part does.
Of several types a topic has, the first is told. Nothing unknown is an error: the answer is empty.
"""

from __future__ import annotations

import asyncio
from collections.abc import Callable, Iterable, Mapping
from typing import TYPE_CHECKING, Any, Final

from ropeway.listener.globs import Globs

if TYPE_CHECKING:
    from ropeway.graph.base import Graph, NodeInfo
    from ropeway.graph.calls import ServiceInfo

__all__ = ["GraphSnapshot", "is_hidden", "is_hidden_node"]

_FRESH_S: Final = 0.02  # a web client asks for the details of every node at once


def is_hidden(name: str) -> bool:
    """Return whether lists leave the topic or service out."""
    return "/_" in name or name.startswith("_")


def is_hidden_node(name: str) -> bool:
    """Return whether lists leave the node out."""
    last = name.rpartition("/")[2]
    return not last or last.startswith("_")


class GraphSnapshot:
    """A graph as rosapi shows it. ``own`` are the services of rosapi itself, by name, with their types."""

    def __init__(self, graph: Graph, globs: Globs, own: Mapping[str, str], changes: Callable[[], int]) -> None:
        self._graph, self._globs, self._own = graph, globs, own
        self._changes = changes
        self._nodes: dict[str, NodeInfo] = {}
        self._nodes_at: tuple[int, float] = (-1, 0.0)

    # ── topics ─────────────────────────────────────────────────────────────────────────────────────────────────

    def topics(self) -> dict[str, str]:
        """Return topics and their types, sorted by name."""
        patterns = self._globs.topics
        found = self._graph.topics()
        return {
            name: info.type
            for name, info in sorted(found.items())
            if info.types and not is_hidden(name) and Globs.allows(name, patterns)
        }

    def topic_type(self, topic: str) -> str:
        """Return the type of a topic, or ``""``."""
        name = _absolute(topic)
        info = self._graph.topics().get(name)
        shown = info is not None and not is_hidden(name) and Globs.allows(name, self._globs.topics)
        return info.type if shown and info is not None else ""

    def publishers(self, topic: str) -> list[str]:
        """Return the nodes that publish a topic."""
        name = _absolute(topic)
        info = self._graph.topics().get(name)
        shown = info is not None and not is_hidden(name) and Globs.allows(name, self._globs.topics_pub)
        return _nodes_of(info.publishers) if shown and info is not None else []

    def subscribers(self, topic: str) -> list[str]:
        """Return the nodes that read a topic."""
        name = _absolute(topic)
        info = self._graph.topics().get(name)
        shown = info is not None and not is_hidden(name) and Globs.allows(name, self._globs.topics_sub)
        return _nodes_of(info.subscriptions) if shown and info is not None else []

    # ── services ───────────────────────────────────────────────────────────────────────────────────────────────

    def services(self) -> dict[str, str]:
        """Return services and their types, sorted by name, including those of rosapi."""
        found = {name: info.type for name, info in self._graph.services().items() if _served(info)}
        patterns = self._globs.services
        return {
            name: type
            for name, type in sorted({**found, **self._own}.items())
            if type and not is_hidden(name) and Globs.allows(name, patterns)
        }

    def service_type(self, service: str) -> str:
        """Return the type of a service, or ``""``."""
        name = _absolute(service)
        if is_hidden(name) or not Globs.allows(name, self._globs.services):
            return ""
        info = self._graph.services().get(name)
        return self._own.get(name) or (info.type if info is not None and _served(info) else "")

    def providers(self, type: str) -> list[str]:
        """Return the nodes that serve a service of this type; the name of a service is accepted, too."""
        if not Globs.allows(type, self._globs.services):
            return []
        nodes: dict[str, None] = {}
        for name, info in self._graph.services().items():
            if not is_hidden(name) and (type in info.types or type == name):
                nodes.update(dict.fromkeys(_nodes_of(info.servers)))
        if type in self._own or type in self._own.values():
            nodes.update(dict.fromkeys(self._here()))
        return list(nodes)

    def service_node(self, service: str) -> str:
        """Return the node that serves a service, or ``""``."""
        name = _absolute(service)
        if is_hidden(name) or not Globs.allows(name, self._globs.services):
            return ""
        info = self._graph.services().get(name)
        nodes = self._here() if name in self._own else _nodes_of(info.servers) if info is not None else []
        return nodes[0] if nodes else ""

    # ── actions ────────────────────────────────────────────────────────────────────────────────────────────────

    def action_servers(self) -> list[str]:
        """Return the actions that have a server, sorted."""
        patterns = self._globs.topics
        return [
            name
            for name, info in sorted(self._graph.actions().items())
            if (info.servers or not info.clients)
            and all(Globs.allows(f"{name}/_action/{end}", patterns) for end in ("feedback", "status"))
        ]

    def action_type(self, action: str) -> str:
        """Return the type of an action, or ``""``."""
        info = self._graph.actions().get(_absolute(action))
        return info.type if info is not None else ""

    # ── nodes ──────────────────────────────────────────────────────────────────────────────────────────────────

    def nodes(self) -> dict[str, NodeInfo]:
        """Return nodes by full name. Calls that come together share what they see, unless we change something
        ourselves.
        """
        now, changes = asyncio.get_running_loop().time(), self._changes()
        seen, at = self._nodes_at
        if seen != changes or now - at > _FRESH_S:
            self._nodes = {n: i for n, i in sorted(self._graph.nodes().items()) if not is_hidden_node(n)}
            self._nodes_at = changes, asyncio.get_running_loop().time()
        return self._nodes

    def node_details(self, node: str) -> dict[str, Any]:
        """Return what a node reads, publishes and serves; empty for an unknown one."""
        info = self.nodes().get(_absolute(node))
        return {
            "subscribing": _names(info.subscriptions) if info is not None else [],
            "publishing": _names(info.publishers) if info is not None else [],
            "services": _names(info.services) if info is not None else [],
        }

    def _here(self) -> list[str]:
        return [name for name, info in self.nodes().items() if info.local][:1]


def _absolute(name: str) -> str:
    return name if name.startswith("/") else f"/{name}"


def _names(pairs: Iterable[tuple[str, str]]) -> list[str]:
    return sorted({name for name, _ in pairs if not is_hidden(name)})


def _served(info: ServiceInfo) -> bool:
    """Return whether it has a server, or no client that only waits for one."""
    return bool(info.servers) or not info.clients


def _nodes_of(ends: Iterable[Any]) -> list[str]:
    """Return the nodes of endpoints or providers, each once, sorted."""
    return sorted({end.node for end in ends if end.node and not is_hidden_node(end.node)})
