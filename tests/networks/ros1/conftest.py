"""A master of its own for each test, and graphs on it."""

from __future__ import annotations

from collections.abc import AsyncIterator, Awaitable, Callable, Iterator
from contextlib import AsyncExitStack
from pathlib import Path

import pytest

from ropeway.networks.ros1 import Ros1Graph
from ropeway.types import TypeRegistry

from .network import HAS_MASTER, RosMaster

Join = Callable[..., Awaitable[Ros1Graph]]


@pytest.fixture
def master(tmp_path: Path) -> Iterator[RosMaster]:
    """A running master."""
    if not HAS_MASTER:
        pytest.skip("needs rosmaster, which .ci/run installs on Debian")
    made = RosMaster(tmp_path)
    made.start()
    yield made
    made.kill()


@pytest.fixture
async def join(master: RosMaster) -> AsyncIterator[Join]:
    """Opens graphs on the master."""
    async with AsyncExitStack() as stack:

        async def joined(name: str = "near", registry: TypeRegistry | None = None) -> Ros1Graph:
            graph = Ros1Graph(master.uri, name=name, poll_s=0.1, registry=registry)
            await graph.open()
            stack.push_async_callback(graph.close)
            return graph

        yield joined
