"""Shows our graph to a gateway that asked: everything once, then what changes."""

from __future__ import annotations

import asyncio
from collections.abc import AsyncIterator, Callable, Mapping
from typing import TYPE_CHECKING, Any, Final

from ropeway.graph.rosbridge.mirror import describe
from ropeway.tasks import Supervised

if TYPE_CHECKING:
    from ropeway.graph.base import Graph, GraphEvent

__all__ = ["Watch"]

_GATHER_S: Final = 0.02  # changes come in flocks; one message tells of all


class Watch:
    """Sends ``graph`` messages until closed."""

    def __init__(self, graph: Graph, send: Callable[[Mapping[str, Any]], None]) -> None:
        self._graph, self._send = graph, send
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

    async def close(self) -> None:
        """Stop telling."""
        await self._task.close()
