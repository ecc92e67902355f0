"""Gateways in this process, each on a memory network of its own, and participants of these networks, as a fixture."""

from __future__ import annotations

import itertools
from collections.abc import AsyncIterator
from contextlib import AsyncExitStack
from typing import Any

import pytest

from ropeway.gateway.config import config
from ropeway.gateway.gateway import Gateway
from ropeway.networks.memory.graph import MemoryGraph, _networks

__all__ = ["World", "url", "world"]

_numbers = itertools.count()


class World:
    """Gateways by name, each on its own memory network, and participants on those networks."""

    def __init__(self, stack: AsyncExitStack) -> None:
        self.stack = stack
        self.number = next(_numbers)

    def network(self, name: str) -> str:
        return f"{name}-{self.number}"

    async def gateway(self, name: str, remotes: list[dict[str, Any]], *, port: int = 0, **settings: Any) -> Gateway:
        gateway = Gateway(
            config.parse(
                {
                    "gateway": {
                        "name": name,
                        "graphs": [f"memory:{self.network(name)}"],
                        "listen": [f"ws://127.0.0.1:{port}"],
                        **settings,
                    },
                    "remotes": remotes,
                }
            )
        )
        await self.stack.enter_async_context(gateway)
        return gateway

    async def robot(self, name: str) -> MemoryGraph:
        graph = MemoryGraph(self.network(name), node="/robot")
        await graph.open()
        self.stack.push_async_callback(graph.close)
        return graph


@pytest.fixture
async def world() -> AsyncIterator[World]:
    """Everything that was made is closed, and nothing is left over."""
    async with AsyncExitStack() as stack:
        world = World(stack)
        yield world
    assert not [n for n in _networks if n.endswith(f"-{world.number}")]


def url(gateway: Gateway) -> str:
    return f"ws://127.0.0.1:{gateway.servers[0].listeners[0].port}"
