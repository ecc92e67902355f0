"""ropeway.delivery.throttle."""

from __future__ import annotations

import asyncio

import pytest

from ropeway.delivery.throttle import Throttle
from ropeway.graph.base import Sample
from ropeway.limits import THROTTLED_BYTES, THROTTLED_MESSAGES
from tests.support.clock import Stopwatch

pytestmark = pytest.mark.jumping


class Place:
    def __init__(self, period_s: float, length: int) -> None:
        self.sent: list[tuple[float, int]] = []
        self._watch = Stopwatch()
        self.dropped = 0
        self.throttle = Throttle(period_s, length, self._send, self._drop)

    def put(self, *numbers: int) -> None:
        for number in numbers:
            self.throttle.put(Sample(b"", "", 0, b"", number))

    def _send(self, sample: Sample) -> None:
        self.sent.append((self._watch.seconds, sample.seq))

    def _drop(self) -> None:
        self.dropped += 1

    @property
    def numbers(self) -> list[int]:
        return [number for _, number in self.sent]


async def test_newest_wait() -> None:
    """The first message goes at once, the newest of the others one by one in their time, the rest are dropped."""
    place = Place(0.05, 3)
    place.put(*range(10))
    assert place.numbers == [0]
    assert place.dropped == 6
    await asyncio.sleep(1)
    assert place.sent == [(0, 0), (0.05, 7), (0.1, 8), (0.15, 9)]


async def test_pause() -> None:
    """After a pause longer than the period a message goes at once again."""
    place = Place(0.02, 1)
    place.put(1)
    await asyncio.sleep(0.05)
    place.put(2)
    assert place.numbers == [1, 2]


async def test_close() -> None:
    """What waits at the close is given back, and nothing more is sent."""
    place = Place(0.01, 5)
    place.put(1, 2, 3)
    assert [s.seq for s in place.throttle.close()] == [2, 3]
    await asyncio.sleep(0.03)
    assert place.numbers == [1]
    assert place.throttle.close() == []


async def test_length() -> None:
    """At least one message may wait."""
    place = Place(0.01, 0)
    place.put(1, 2)
    await asyncio.sleep(1)
    assert place.numbers == [1, 2]
    place.throttle.close()


async def test_queue_is_bounded() -> None:
    """Whatever length a client asks for, no more than so many messages and bytes wait, and the others are counted."""
    place = Place(100, 10**9)
    place.put(*range(1000))
    assert place.dropped == 999 - THROTTLED_MESSAGES
    assert [sample.seq for sample in place.throttle.close()] == list(range(1000 - THROTTLED_MESSAGES, 1000))

    heavy = Place(100, 10**9)
    for number in range(50):
        heavy.throttle.put(Sample(bytes(THROTTLED_BYTES // 8), "", 0, b"", number))
    assert heavy.throttle.bytes <= THROTTLED_BYTES
    assert heavy.dropped == 49 - 8
    assert [sample.seq for sample in heavy.throttle.close()] == list(range(42, 50))
    assert heavy.throttle.bytes == 0
