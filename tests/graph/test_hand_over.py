"""ropeway.graph.hand_over: from a thread to the event loop."""

from __future__ import annotations

import asyncio
from typing import Any

import pytest

from ropeway.graph.hand_over import HandOver


class Waiting(HandOver):
    """A thread that counts how often it is woken."""

    woken = 0

    def _wake(self) -> None:
        self.woken += 1

    def starve(self) -> None:
        """Find no room."""
        self._starved = True


async def test_batches_for_one_function_are_joined() -> None:
    """What a thread pushes for one function arrives at once and in order, on the loop."""
    out, got = Waiting("x"), asyncio.Queue[list[Any]]()
    await asyncio.to_thread(lambda: [out.push(got.put_nowait, [n], 1, 10) for n in range(3)])
    seen: list[Any] = []
    while len(seen) < 3:
        seen += await got.get()
    assert seen == [0, 1, 2]
    assert out.room


async def test_what_waits_is_bounded() -> None:
    """There is room again, and the thread is woken, once the loop has taken what was pushed."""
    out, got = Waiting("x"), asyncio.Event()
    samples, size = out.space()
    out.push(lambda _: got.set(), ["much"], samples, size)
    assert not out.room
    out.starve()
    await got.wait()
    await asyncio.sleep(0)
    assert out.space() == (samples, size)
    assert out.woken == 1


async def test_other_threads_push_what_does_not_count() -> None:
    """What is pushed without a size takes no room."""
    out = Waiting("x")
    before = out.space()
    await asyncio.to_thread(out.push, lambda _: None, ["note"])
    assert out.space() == before


async def test_one_taker_that_fails_costs_the_others_nothing(caplog: pytest.LogCaptureFixture) -> None:
    """A function that fails is told in the log, and those after it get what is theirs."""
    out, got = Waiting("the thread"), asyncio.Event()

    def fail(_: list[Any]) -> None:
        raise ValueError("bad")

    out.push(fail, [1, 2])
    out.push(lambda _: got.set(), [3])
    await got.wait()
    assert "the thread: delivering 2 items failed" in caplog.messages
