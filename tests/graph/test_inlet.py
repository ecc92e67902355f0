"""ropeway.graph.inlet: what waits for the event loop is bounded and counted."""

from __future__ import annotations

import asyncio
import threading

import pytest

from ropeway.graph.inlet import Inlet, one_by_one
from tests.support.until import until


async def test_in_order_and_in_batches() -> None:
    """Everything that several threads put comes to the loop, in the order of each thread."""
    given: list[tuple[int, int]] = []
    inlet: Inlet[tuple[int, int]] = Inlet(asyncio.get_running_loop(), given.extend)
    threads = [threading.Thread(target=lambda n=n: [inlet.put((n, i), 10) for i in range(500)]) for n in range(4)]
    for thread in threads:
        thread.start()
    await until(lambda: len(given) == 2000)
    for thread in threads:
        thread.join()
    for n in range(4):
        assert [i for m, i in given if m == n] == list(range(500))
    assert inlet.waiting_bytes == 0


async def test_a_loop_that_is_behind() -> None:
    """However much comes while the loop does something else, no more than the limit waits; the newest is given."""
    given: list[int] = []
    lost: list[int] = []
    inlet: Inlet[int] = Inlet(asyncio.get_running_loop(), given.extend, limit_bytes=100_000, on_lost=lost.append)
    for i in range(10_000):
        inlet.put(i, 1000)
        assert inlet.waiting_bytes <= 100_000
    await until(lambda: given)
    assert given == list(range(10_000 - len(given), 10_000))
    assert lost == list(range(10_000 - len(given)))
    assert inlet.lost == len(lost)


async def test_the_last_one_stays() -> None:
    """Something that is larger than the limit is given if it is alone."""
    given: list[int] = []
    inlet: Inlet[int] = Inlet(asyncio.get_running_loop(), given.extend, limit_bytes=1000)
    inlet.put(1, 5000)
    inlet.put(2, 5000)
    await until(lambda: given == [2])


async def test_one_item_fails_alone(caplog: pytest.LogCaptureFixture) -> None:
    """An item whose taking fails is told, and the others of its batch are taken."""
    given: list[int] = []

    def take(item: int) -> None:
        given.append(10 // item)

    inlet: Inlet[int] = Inlet(asyncio.get_running_loop(), one_by_one(take))
    for item in (1, 0, 5):
        inlet.put(item)
    await until(lambda: given == [10, 2])
    assert "could not be delivered" in caplog.text
