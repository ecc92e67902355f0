"""Real participants on the loopback interface, out of sight of every other test run on this machine."""

from __future__ import annotations

import itertools
import shutil
import sys
from collections.abc import AsyncIterator, Awaitable, Callable

import pytest

from ropeway.networks.dds import DdsGraph

_domains = itertools.cycle(range(40, 56))


@pytest.fixture
def domain() -> int:
    """A domain for one test."""
    return next(_domains)


needs_elf = pytest.mark.skipif(
    sys.platform != "linux" or shutil.which("cc") is None, reason="there is no C compiler, or this is not Linux"
)

Join = Callable[..., Awaitable[DdsGraph]]


@pytest.fixture
async def join(domain: int) -> AsyncIterator[Join]:
    """A function that opens a graph in the test's domain; all are closed at the end."""
    graphs: list[DdsGraph] = []

    async def open_graph(name: str = "ropeway", **options: object) -> DdsGraph:
        graph = DdsGraph(domain, name=name, interface="lo", **options)  # type: ignore[arg-type]
        await graph.open()
        graphs.append(graph)
        return graph

    yield open_graph
    for graph in reversed(graphs):
        await graph.close()
