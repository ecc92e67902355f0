"""Tests of ``ropeway.graph.kept``."""

from __future__ import annotations

import gc
import weakref

import pytest

from ropeway.graph.actions import ComposedActionServer
from ropeway.graph.calls import ActionHandlers, Outcome, ServerGoal
from ropeway.graph.kept import Kept
from ropeway.networks.memory.graph import MemoryGraph

pytestmark = pytest.mark.jumping


class _Part:
    closed = False

    async def close(self) -> None:
        self.closed = True


async def test_closed_parts_are_forgotten_as_others_come() -> None:
    """Of many parts that come and go, at most a few closed ones are kept."""
    kept: Kept[_Part] = Kept()
    staying = _Part()
    kept.add(staying)
    for _ in range(1000):
        part = _Part()
        kept.add(part)
        await part.close()
    assert list(kept) == [staying]
    assert len(kept._parts) <= 64
    await kept.close()
    assert staying.closed
    assert list(kept) == []


async def test_a_closed_action_server_is_let_go() -> None:
    """A graph holds nothing of an action server that was closed."""

    async def never(goal: ServerGoal) -> Outcome:
        raise AssertionError

    graph = MemoryGraph("kept")
    await graph.open()
    server = await graph.create_action_server("/a", "example_interfaces/action/Fibonacci", ActionHandlers(never))
    assert isinstance(server, ComposedActionServer)
    left = weakref.ref(server)
    await server.close()
    del server
    gc.collect()
    assert left() is None
    await graph.close()
