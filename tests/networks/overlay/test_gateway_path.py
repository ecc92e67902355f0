"""The path to a gateway that acknowledges."""

from __future__ import annotations

import heapq
import itertools
import random
from collections import deque
from collections.abc import Iterator

import pytest

from ropeway.networks.overlay.gateway_path import Path

LANE = 4
PART_BYTES = 4096


class Link:
    """A link of ``rate`` bytes a second and ``delay_s`` one way; what comes is acknowledged at once."""

    def __init__(self, rate: float, delay_s: float) -> None:
        self.rate, self.delay_s = rate, delay_s
        self.free_at_s = 0.0
        self.events: list[tuple[float, int]] = []
        self.carried = 0
        self.queues_s: list[float] = []

    def send(self, now_s: float, number: int, size: int) -> None:
        self.free_at_s = max(self.free_at_s, now_s) + size / self.rate
        if now_s > 2.0:
            self.queues_s.append(self.free_at_s - now_s)
            self.carried += size
        heapq.heappush(self.events, (self.free_at_s + 2 * self.delay_s, number))


def greedy(path: Path, link: Link, until_s: float) -> None:
    """Send as much as the path has room for."""
    numbers = itertools.count(1)
    now_s = 0.0
    while now_s < until_s:
        while path.room_bytes(now_s) > 0:
            size, number = max(path.part_bytes, PART_BYTES), next(numbers)
            path.hand(size)
            path.sent(LANE, number, size, now_s)
            path.landed(size)
            link.send(now_s, number, size)
        now_s, number = heapq.heappop(link.events)
        path.acknowledged([(LANE, number)], now_s)


@pytest.mark.parametrize(("rate", "delay_s"), [(625e3, 0.035), (2.5e6, 0.01), (12.5e6, 0.035), (12.5e6, 0.0)])
def test_full_and_fresh(rate: float, delay_s: float) -> None:
    """A link is filled, and little waits before it."""
    path, link = Path(), Link(rate, delay_s)
    greedy(path, link, 12.0)
    assert link.carried > 0.9 * rate * 10
    assert sum(link.queues_s) / len(link.queues_s) < max(0.025, 0.4 * 2 * delay_s)  # its own part is in it
    assert path.model.pace.bytes_per_s == pytest.approx(rate, rel=0.15)


def test_more_than_was_sent() -> None:
    """Acknowledging what was not sent yet counts for what was."""
    path = Path()
    path.sent(LANE, 1, 1000, 0.0)
    path.acknowledged([(LANE, 1 << 63), (200, 5), (0, 7)], 0.01)
    assert path.in_flight_bytes == 0
    path.sent(LANE, 2, 1000, 0.02)
    assert path.in_flight_bytes == 1000


def test_one_that_is_lost() -> None:
    """A packet that never came is accounted for by one that came after it."""
    path = Path()
    for number in (1, 2, 3):
        path.sent(LANE, number, 1000, 0.0)
    path.acknowledged([(LANE, 1)], 0.01)
    assert path.in_flight_bytes == 2000
    path.acknowledged([(LANE, 3)], 0.02)
    assert path.in_flight_bytes == 0


def test_stalled() -> None:
    """A path that acknowledges nothing holds nobody up after a while, and is heeded again once it does."""
    path = Path()
    now_s = 0.0
    for number in itertools.count(1):
        if path.room_bytes(now_s) <= 0:
            break
        path.hand(PART_BYTES)
        path.sent(LANE, number, PART_BYTES, now_s)
        path.landed(PART_BYTES)
    assert path.room_bytes(0.5) <= 0
    assert path.room_bytes(2.0) > 1 << 30
    assert path.stalled
    path.sent(LANE, 100, PART_BYTES, 2.0)
    path.acknowledged([(LANE, 100)], 2.1)
    assert not path.stalled
    assert path.room_bytes(2.1) < 1 << 30


def test_lanes_overtake() -> None:
    """What is acknowledged in one lane says nothing of another."""
    path = Path()
    path.sent(4, 1, 5000, 0.0)
    path.sent(0, 1, 100, 0.0)
    path.acknowledged([(0, 1)], 0.01)
    assert path.in_flight_bytes == 5000


class Losing:
    """A link that loses packets; what comes is in order, and what was lost comes one and a half round trips later."""

    def __init__(self, rate: float, delay_s: float, loss: float) -> None:
        self.rate, self.delay_s, self.loss = rate, delay_s, loss
        self.chance = random.Random(1)
        self.free_at_s = self.came_s = 0.0
        self.carried = 0
        self.queues_s: list[float] = []

    def send(self, now_s: float, size: int) -> float:
        """Return when it is acknowledged."""
        self.free_at_s = max(self.free_at_s, now_s) + size / self.rate
        arrives_s = self.free_at_s + self.delay_s
        while self.chance.random() < self.loss:
            arrives_s += 3 * self.delay_s
        self.came_s = max(self.came_s, arrives_s)
        if now_s > 2.0:
            self.queues_s.append(self.free_at_s - now_s)
            self.carried += size
        return self.came_s + self.delay_s


@pytest.mark.parametrize("loss", [0.01, 0.03, 0.06])
def test_full_although_packets_are_lost(loss: float) -> None:
    """A link that loses packets, of which each holds up all behind it, is filled, and little waits before it."""
    rate, look_s = 2.5e6, 0.004
    path, link = Path(), Losing(rate, 0.01, loss)
    coming: deque[tuple[float, int]] = deque()
    numbers, now_s = itertools.count(1), 0.0
    while now_s < 12.0:
        while path.room_bytes(now_s) > 0:
            number = next(numbers)
            path.hand(PART_BYTES)
            path.sent(LANE, number, PART_BYTES, now_s)
            path.landed(PART_BYTES)
            coming.append((link.send(now_s, PART_BYTES), number))
        now_s = min(now_s + look_s, coming[0][0])
        while coming and coming[0][0] <= now_s:
            path.acknowledged([(LANE, coming.popleft()[1])], now_s)
    assert link.carried > 0.7 * rate * 10
    assert sum(link.queues_s) / len(link.queues_s) < 0.06  # three round trips
    assert path.model.pace.bytes_per_s == pytest.approx(rate, rel=0.3)


def steady() -> tuple[Path, float]:
    """Return a path on which packets came regularly for a while, and the time."""
    path, now_s = Path(), 0.0
    for number in range(1, 200):
        path.sent(LANE, number, PART_BYTES, now_s)
        path.acknowledged([(LANE, number)], now_s + 0.02)
        now_s += 0.002
    path.model.starting = False
    path.model.pace.carried(2_000_000, 1.0)
    return path, now_s


def fill(path: Path, now_s: float, numbers: Iterator[int]) -> int:
    """Send all that a path has room for at a time; return how much that was."""
    sent = 0
    while path.room_bytes(now_s) > 0:
        path.hand(PART_BYTES)
        path.sent(LANE, next(numbers), PART_BYTES, now_s)
        path.landed(PART_BYTES)
        sent += PART_BYTES
    return sent


def test_what_is_late_has_left_the_link() -> None:
    """While a lost packet holds up what was sent after it, one and a half times as much may be sent, and no more."""
    (path, now_s), numbers = steady(), itertools.count(200)
    window = path.model.window_bytes
    sent = sum(fill(path, now_s + 0.002 * i, numbers) for i in range(200))
    assert 2.5 * window - PART_BYTES <= sent <= 2.5 * window + 2 * PART_BYTES


def test_spread_over_time() -> None:
    """Of what there is room for at once, a little goes at once and the rest while the path carries it away."""
    (path, now_s), numbers = steady(), itertools.count(200)
    pace = path.model.pace.bytes_per_s
    assert pace is not None
    first, second = fill(path, now_s, numbers), fill(path, now_s + 0.004, numbers)
    assert first <= max(0.005 * pace, 2 * path.part_bytes) + PART_BYTES < path.model.window_bytes
    assert 0 < second <= 1.25 * 0.004 * pace + PART_BYTES


@pytest.mark.parametrize(("delay_s", "copied"), [(0.01, True), (0.001, False)])
def test_copies_beside_big_messages(delay_s: float, copied: bool) -> None:
    """Small packets have copies while big messages go over a distance, and for a little while after."""
    path, publisher = Path(), bytes(16)
    greedy(path, Link(2.5e6, delay_s), 3.0)
    assert path.far is copied
    assert not path.copies(publisher, 300, 3.0)
    path.laden(3.0)
    assert path.copies(publisher, 300, 3.5) is copied
    assert not path.copies(publisher, 300, 4.5)
