"""Visitors who come and go by the thousand, after whom a gateway is what it was before."""

from __future__ import annotations

import asyncio
import os

import pytest

from tests.soak.process import serving
from tests.soak.visits import VISITS, Visit

COUNT = int(os.environ.get("ROPEWAY_VISITS", "2000"))
WARM_UP = 1100  # visits that fill what is bounded: 1,024 calls and names are remembered
AT_ONCE = 20
GROWTH_BYTES = 16 << 20  # what allocators keep of the moment when most were there; a leak shows in the objects
GROWTH_OBJECTS = 40  # of one class
CONFIG = {
    "gateway": {
        "name": "churn",
        "graphs": ["memory:churn"],
        "listen": ["ws://127.0.0.1:0", "iort://127.0.0.1:0"],
        "clients": {"unregister_timeout_s": 0.2},
        "store": {"path": "memory:"},
    }
}

pytestmark = [pytest.mark.slow, pytest.mark.timeout(900)]


async def visit(one: Visit, ports: list[int], numbers: range) -> None:
    """All of these visits, some at a time."""
    waiting = iter(numbers)

    async def visitor() -> None:
        for number in waiting:
            await one(ports, number)

    await asyncio.gather(*(visitor() for _ in range(AT_ONCE)))


@pytest.mark.parametrize("one", VISITS, ids=lambda one: one.__name__)
async def test_visits_leave_nothing(one: Visit) -> None:
    """Memory, descriptors, threads, tasks, sessions and objects after thousands of visits are those after a few."""
    async with serving(CONFIG) as gateway:
        await visit(one, gateway.ports, range(WARM_UP))
        before = await gateway.settled()
        await visit(one, gateway.ports, range(WARM_UP, WARM_UP + COUNT))
        after = await gateway.settled(before, GROWTH_OBJECTS)
    assert after.grown(before, GROWTH_OBJECTS) == {}
    assert after.rss_bytes - before.rss_bytes < GROWTH_BYTES
