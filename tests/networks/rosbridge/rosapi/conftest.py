"""rosapi of a gateway ``/gateway`` beside a node ``/robot`` on a network of their own."""

from __future__ import annotations

import itertools
from collections.abc import AsyncIterator
from contextlib import AsyncExitStack
from typing import Any

import pytest

from ropeway.hub.hub import Hub
from ropeway.networks.memory.graph import MemoryGraph
from ropeway.networks.rosbridge.rosapi import Rosapi
from ropeway.types import TypeRegistry

_numbers = itertools.count()
_registry = TypeRegistry()


class Place:
    """A network, and rosapi that looks at it."""

    def __init__(self, stack: AsyncExitStack) -> None:
        self._stack = stack
        self._network = f"rosapi-{next(_numbers)}"
        self.registry = _registry
        self.hub: Hub
        self.rosapi: Rosapi
        self.robot: MemoryGraph

    async def start(self, **options: Any) -> None:
        self.hub = Hub(await self.participant("/gateway"))
        self._stack.push_async_callback(self.hub.close)
        self.rosapi = Rosapi(self.hub, self.registry, **options)
        self._stack.push_async_callback(self.rosapi.close)
        self.robot = await self.participant("/robot")

    async def participant(self, node: str) -> MemoryGraph:
        graph = MemoryGraph(self._network, node=node)
        await graph.open()
        self._stack.push_async_callback(graph.close)
        return graph

    async def ask(self, asked: str, /, **args: Any) -> dict[str, Any]:
        """What rosapi answers."""
        return await self.rosapi.call(f"/rosapi/{asked}", args)


@pytest.fixture
async def bare() -> AsyncIterator[Place]:
    """A place that a test starts itself."""
    async with AsyncExitStack() as stack:
        yield Place(stack)


@pytest.fixture
async def place(bare: Place) -> Place:
    """A place with rosapi as it is by default."""
    await bare.start()
    return bare
