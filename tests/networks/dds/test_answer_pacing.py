"""The speed of answers to nodes."""

from __future__ import annotations

import asyncio

import pytest

from ropeway.networks.dds.answer_pacing import AnswerPacing
from ropeway.tasks import end
from tests.support.clock import Stopwatch

pytestmark = pytest.mark.jumping


async def test_one_after_the_other() -> None:
    """A client that asks again once it has its answer never waits."""
    watch = Stopwatch()
    pace = AnswerPacing()
    for _ in range(100):
        pace.came()
        await pace.turn()
        pace.went()
    assert watch.seconds == 0
    assert pace.idle


async def test_burst() -> None:
    """Of many answers at a time a few go at once, the others one by one."""
    pace = AnswerPacing()
    for _ in range(20):
        pace.came()
    turns = [asyncio.create_task(pace.turn()) for _ in range(20)]
    await asyncio.sleep(0.001)
    assert [turn.done() for turn in turns] == [True] * 5 + [False] * 15
    await asyncio.sleep(0.002)
    assert [turn.done() for turn in turns] == [True] * 6 + [False] * 14
    assert not pace.idle
    await end(*turns)
    assert pace._timer is not None
    pace._timer.cancel()


async def test_in_order() -> None:
    """The others follow, in order, and who has gone is passed over."""
    pace = AnswerPacing()
    went: list[int] = []

    async def answer(number: int) -> None:
        await pace.turn()
        went.append(number)

    for _ in range(20):
        pace.came()
    turns = [asyncio.create_task(answer(number)) for number in range(20)]
    await asyncio.sleep(0)
    await end(turns[10])
    await asyncio.wait(turns, timeout=5)
    assert went == [number for number in range(20) if number != 10]
