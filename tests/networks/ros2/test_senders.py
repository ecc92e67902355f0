"""Threads that send."""

from __future__ import annotations

import threading
from functools import partial
from typing import Any

from ropeway.networks.ros2.senders import Senders
from tests.support.until import PATIENCE_S, until


def senders() -> Senders:
    return Senders("test")


async def test_order() -> None:
    """What one part sends goes out in order."""
    threads = senders()
    done: list[Any] = []
    lane = threads.lane(10_000, 1 << 20, lambda _: None)
    for number in range(2000):
        lane.put(partial(done.append, number))
    await until(lambda: len(done) == 2000)
    assert done == list(range(2000))
    await threads.stop()


async def test_slow_lane() -> None:
    """A part whose reader is slow does not hold up another."""
    threads, gate = senders(), threading.Event()
    done: list[Any] = []
    slow, quick = (threads.lane(10, 1 << 20, lambda _: None) for _ in range(2))
    slow.put(lambda: (gate.wait(2 * PATIENCE_S), None)[1])
    quick.put(lambda: done.append(1))
    await until(lambda: done)
    gate.set()
    await threads.stop()


async def test_bounds() -> None:
    """Beyond its messages or bytes a lane lets the oldest go, and tells how many."""
    threads, gate = senders(), threading.Event()
    done: list[Any] = []
    lost: list[Any] = []
    lane = threads.lane(3, 100, lost.append)
    entered = threading.Event()

    def hold() -> None:
        entered.set()
        gate.wait(PATIENCE_S)

    lane.put(hold)
    await until(entered.is_set)
    for number in range(5):
        lane.put(partial(done.append, number))
    assert sum(lost) == 2
    lane.put(partial(done.append, "big"), 100)
    lane.put(partial(done.append, "bigger"), 1000)
    assert sum(lost) == 6
    gate.set()
    await until(lambda: done)
    assert done == ["bigger"]
    await threads.stop()


async def test_finish() -> None:
    """Finishing a lane runs its last errand after all others and waits for it."""
    threads = senders()
    done: list[Any] = []
    lane = threads.lane(1000, 1 << 20, lambda _: None)
    for number in range(100):
        lane.put(partial(done.append, number))
    await lane.finish(partial(done.append, "last"))
    assert done == [*range(100), "last"]
    await threads.stop()


async def test_stop() -> None:
    """Stopping sends what waits, and ends the threads."""
    threads = senders()
    done: list[Any] = []
    lanes = [threads.lane(1000, 1 << 20, lambda _: None) for _ in range(20)]
    for number in range(100):
        for lane in lanes:
            lane.put(partial(done.append, number))
    await threads.stop()
    assert len(done) == 2000
    assert not [t for t in threading.enumerate() if t.name.startswith("ropeway test")]
    lanes[0].put(partial(done.append, "late"))
    await threads.stop()
