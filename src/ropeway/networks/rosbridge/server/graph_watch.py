"""Shows our graph to a gateway that asked: everything once, then what changes."""

from __future__ import annotations

import asyncio
from collections.abc import AsyncIterator, Callable, Mapping
from typing import TYPE_CHECKING, Any, Final

from ropeway.networks.rosbridge.client.mirror import describe
from ropeway.tasks import Supervised

if TYPE_CHECKING:
    from ropeway.graph.base import Graph, GraphEvent
    from ropeway.listener.authorization import Access

__all__ = ["Watch"]

_GATHER_S: Final = 0.02  # changes come in flocks; one message tells of all


_KINDS: Final = ("topics", "services", "actions")
_KIND_OF: Final = {"publishers": "topics", "subscriptions": "topics", "services": "services", "clients": "services"}


class Watch:
    """Sends ``graph`` messages until closed: of what ``access`` allows anything with, and of the nodes that have it."""

    def __init__(self, graph: Graph, send: Callable[[Mapping[str, Any]], None], access: Access) -> None:
        self._graph, self._send, self._access = graph, send, access
        self._known: dict[str, dict[str, Any]] = {"topics": {}, "nodes": {}, "services": {}, "actions": {}}
        self._task = Supervised(lambda: self._run(graph.changes()), "watch graph").start()

    async def _run(self, changes: AsyncIterator[GraphEvent]) -> None:
        self._tell(everything=True)
        async for _ in changes:
            await asyncio.sleep(_GATHER_S)
            self._tell()

    def _tell(self, *, everything: bool = False) -> None:
        graph = self._graph
        now = describe(graph.topics(), graph.nodes(), graph.services(), graph.actions())
        if not self._access.unrestricted:
            now = self._seen(now)
        message: dict[str, Any] = {"op": "graph"}
        for key, values in now.items():
            known = self._known[key]
            changed: dict[str, Any] = {name: v for name, v in values.items() if known.get(name) != v}
            changed.update(dict.fromkeys(known.keys() - values.keys()))
            if changed or everything:
                message[key] = changed
            self._known[key] = values
        if len(message) > 1:
            self._send(message)

    def _seen(self, everything: dict[str, Any]) -> dict[str, Any]:
        sees = self._access.sees
        found: dict[str, Any] = {
            kind: {name: value for name, value in everything[kind].items() if sees(kind, name)} for kind in _KINDS
        }
        nodes = {
            node: {part: [item for item in has if sees(_KIND_OF[part], item[0])] for part, has in parts.items()}
            for node, parts in everything["nodes"].items()
        }
        found["nodes"] = {node: parts for node, parts in nodes.items() if any(parts.values())}
        return found

    async def close(self) -> None:
        """Stop telling."""
        await self._task.close()
