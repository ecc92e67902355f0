"""model over simulated links: rate, delay, buffer, jitter, loss, others, and changes of all of them."""

from __future__ import annotations

import random
from typing import Any, Final

import pytest

from ropeway.delivery.pacing.model import LinkModel
from ropeway.delivery.pacing.rounds import LinkReading
from tests.delivery.pacing.simulated import (
    HEADERS_BYTES,
    SEGMENT_BYTES,
    Clock,
    Crowd,
    Kernel,
    Path,
    Shared,
    Tcp,
    images,
    simulate,
)

_GOODPUT: Final = SEGMENT_BYTES / (SEGMENT_BYTES + HEADERS_BYTES)
_PART_BYTES: Final = SEGMENT_BYTES
_MBIT: Final = 125_000


def allowed_queue_s(path: Path) -> float:
    """A quarter of the round trip, or a part and the two segments that keep a slow link busy."""
    serial = 2 * (_PART_BYTES + 2 * SEGMENT_BYTES) / (path.rate * (1 - path.cross))
    return max(0.5 * path.delay_s + 2 * path.jitter_s, serial, 0.006)


def check(path: Path, congestion: str = "open", *, warm: float = 45, seconds: float = 3.0) -> None:
    """Let a greedy sender fill the link, and see that it is full and has no queue."""
    round_trip = 2 * path.delay_s + 2 * SEGMENT_BYTES / path.rate
    skip = 1.0 + warm * round_trip
    outcome = simulate(path, congestion=congestion, seconds=skip + max(seconds, 30 * round_trip), skip_s=skip)
    left = path.rate * (1 - path.cross) * _GOODPUT * (1 - path.loss)
    packets = 3 * SEGMENT_BYTES / max(seconds, 30 * round_trip)  # what the ends of the time may cut off
    assert outcome.rate >= 0.9 * left - packets, (path, outcome)
    assert outcome.queue_s <= allowed_queue_s(path), (path, outcome)


@pytest.mark.parametrize("congestion", ["open", "reno"])
@pytest.mark.parametrize("delay_ms", [0.1, 10, 35])
@pytest.mark.parametrize("mbit", [2, 20, 100])
def test_full_and_without_a_queue(mbit: float, delay_ms: float, congestion: str) -> None:
    """A link is full at any rate and delay, and nothing waits in its deep buffer."""
    check(Path(mbit * _MBIT, delay_ms / 1e3), congestion)


@pytest.mark.parametrize(("jitter_ms", "loss"), [(2, 0.0), (0, 0.01), (2, 0.03), (0, 0.05)])
def test_jitter_and_losses(jitter_ms: float, loss: float) -> None:
    """Packets that are late, early or lost leave the link full."""
    check(Path(20 * _MBIT, 0.01, jitter_s=jitter_ms / 1e3, loss=loss))


@pytest.mark.parametrize("luck_ms", [1, 2, 3])
@pytest.mark.parametrize("mbit", [5, 20, 50])
def test_a_lucky_first_round_trip(mbit: float, luck_ms: float) -> None:
    """Where round trips vary, the link is full though the first, which nothing smooths, was shorter than any other."""
    path = Path(mbit * _MBIT, 0.01, jitter_s=0.002)
    outcome = simulate(path, seconds=4.0, skip_s=1.5, luck_s=luck_ms / 1e3)  # before it would be forgotten anyway
    assert outcome.rate >= 0.9 * path.rate * _GOODPUT, outcome
    assert outcome.queue_s <= allowed_queue_s(path), outcome


@pytest.mark.parametrize("mbit", [5, 20])
def test_messages_that_fit_the_window(mbit: float) -> None:
    """Pictures that need less than the link make no longer a queue than those that need all of it."""
    path, clock = Path(mbit * _MBIT, 0.01, jitter_s=0.002), Clock()
    tcp, model = Kernel(clock, path), LinkModel()
    waits: list[float] = []

    def sample() -> None:
        waits.append(path.queue_s(clock.now))
        clock.at(clock.now + 0.001, sample)

    clock.at(0.0, lambda: images(clock, tcp, model, int(0.6 * path.rate / 15), 15))
    clock.at(2.0, sample)
    clock.run(6.0)
    assert sorted(waits)[int(0.99 * len(waits))] <= 0.02 + 4 * SEGMENT_BYTES / path.rate
    assert tcp.delivered >= 0.55 * 6.0 * path.rate


@pytest.mark.parametrize("mbit", [2, 5])
def test_a_slow_link(mbit: float) -> None:
    """On a slow link that is far, full and ours fewer than two segments wait."""
    path = Path(mbit * _MBIT, 0.035)
    outcome = simulate(path, seconds=14, skip_s=8)
    assert outcome.rate >= 0.93 * path.rate * _GOODPUT, outcome
    assert outcome.queue_s <= 2 * SEGMENT_BYTES / path.rate, outcome


def test_a_shallow_buffer() -> None:
    """A link that holds twenty packets is full all the same."""
    check(Path(20 * _MBIT, 0.01, buffer=20))


@pytest.mark.parametrize("cross", [0.5, 0.8])
def test_others_use_the_link(cross: float) -> None:
    """What others leave of a link is used."""
    check(Path(20 * _MBIT, 0.02, cross=cross))


def links(count: int, *, seed: int, most_mbit: float, most_ms: float, others: bool) -> list[Path]:
    """Make links of any rate, delay, jitter and loss, the same ones every time."""
    chance = random.Random(seed)
    made = []
    for number in range(count):
        mbit, delay_s = chance.uniform(1.0, most_mbit), chance.uniform(1e-4, most_ms / 1e3)
        jitter_s = chance.choice((0.0, 0.1, 0.2)) * delay_s
        loss = chance.choice((0.0, 0.0, 0.01) if others else (0.0, 0.0, 0.01, 0.05))
        cross = chance.choice((0.0, 0.0, 0.5)) if others else 0.0
        made.append(Path(mbit * _MBIT, delay_s, jitter_s=jitter_s, loss=loss, seed=number, cross=cross))
    return made


RANDOM = links(25, seed=2, most_mbit=60, most_ms=80, others=False)


@pytest.mark.parametrize("path", [*RANDOM[:8], *(pytest.param(path, marks=pytest.mark.slow) for path in RANDOM[8:])])
def test_random_links(path: Path) -> None:
    """Any link is full and has no queue."""
    check(path)


@pytest.mark.slow
@pytest.mark.timeout(900)
def test_many_links() -> None:
    """Any link is full and has no queue, a hundred times, also where others use half of it."""
    for path in links(100, seed=3, most_mbit=60, most_ms=60, others=True):
        check(path, seconds=1.0)


@pytest.mark.parametrize("factor", [0.5, 2.0, 5.0])
@pytest.mark.parametrize("delay_ms", [10, 35])
def test_a_change_of_rate(factor: float, delay_ms: float) -> None:
    """Ten round trips after a change of the rate the link is full again, and a little later without a queue."""
    delay_s = delay_ms / 1e3
    for rounds in (10, 30):
        path = Path(20 * _MBIT, delay_s)

        def change(path: Path = path) -> None:
            path.rate *= factor

        after = 3.0 + rounds * 2 * delay_s
        outcome = simulate(path, seconds=after + 1.0, skip_s=after, change=change, change_at=3.0)
        assert outcome.rate >= 0.9 * path.rate * _GOODPUT, (rounds, outcome)
        if rounds == 30:
            assert outcome.queue_s <= allowed_queue_s(path), outcome


@pytest.mark.parametrize(("before_ms", "after_ms"), [(10, 50), (50, 10), (5, 100)])
def test_a_change_of_delay(before_ms: float, after_ms: float) -> None:
    """A route that becomes longer or shorter is noticed, and the link is full again."""
    path = Path(20 * _MBIT, before_ms / 1e3)

    def change() -> None:
        path.delay_s = after_ms / 1e3

    after = 3.0 + 25 * 2 * after_ms / 1e3
    outcome = simulate(path, seconds=after + 2.0, skip_s=after, change=change, change_at=3.0)
    assert outcome.rate >= 0.9 * path.rate * _GOODPUT


@pytest.mark.parametrize("more_ms", [1, 2, 3])
@pytest.mark.parametrize(("mbit", "delay_ms"), [(5, 35), (20, 10), (100, 35)])
def test_a_little_more_delay(mbit: float, delay_ms: float, more_ms: float) -> None:
    """A route that becomes a little longer, by no more than a queue would take, is as full a second later."""
    path = Path(mbit * _MBIT, delay_ms / 1e3)

    def change() -> None:
        path.delay_s += more_ms / 1e3

    outcome = simulate(path, seconds=6.0, skip_s=4.0, change=change, change_at=3.0)
    assert outcome.rate >= 0.95 * path.rate * _GOODPUT, outcome


@pytest.mark.parametrize("delay_ms", [10, 60])
def test_a_change_of_both(delay_ms: float) -> None:
    """A route that becomes longer and four times as fast is full again soon."""
    path = Path(5 * _MBIT, 0.01)

    def change() -> None:
        path.rate, path.delay_s = 20 * _MBIT, delay_ms / 1e3

    after = 3.0 + 25 * 2 * delay_ms / 1e3
    outcome = simulate(path, seconds=after + 2.0, skip_s=after, change=change, change_at=3.0)
    assert outcome.rate >= 0.9 * path.rate * _GOODPUT, outcome


def beside(path: Path, *, seconds: float, late_s: float = 0.0, begin_s: float = 3.0, **crowd: Any) -> Shared:
    """Let senders share a link with one that fills it, from ``begin_s`` on; tell of the second half."""
    ours = Crowd(path, late_s=late_s, **crowd)
    ours.run(begin_s)
    ours.filling = True
    ours.run(seconds / 2 - begin_s)
    return ours.run(seconds / 2)


@pytest.mark.parametrize("late_s", [0.0, pytest.param(6.0, marks=pytest.mark.slow)])
@pytest.mark.parametrize(
    ("congestion", "other"),
    [("open", "reno"), ("cubic", "cubic"), pytest.param("reno", "reno", marks=pytest.mark.slow)],
)
def test_beside_one_who_fills_the_link(congestion: str, other: str, late_s: float) -> None:
    """Two senders whose pictures need less than their share get nearly all of it beside one who fills a deep queue."""
    need = 152_000 * 15
    path = Path(100 * _MBIT, 0.01)
    got = beside(path, seconds=30.0, late_s=late_s, size=152_000, count=2, congestion=congestion, other=other)
    assert min(got.ours) >= 0.85 * need, got
    assert got.other >= 0.3 * 100 * _MBIT


@pytest.mark.parametrize("late_s", [0.0, 6.0])
@pytest.mark.parametrize(("congestion", "other"), [("open", "reno"), ("reno", "reno"), ("cubic", "cubic")])
def test_not_starved(congestion: str, other: str, late_s: float) -> None:
    """A sender who could use the whole link keeps a part of it beside one who fills its deep queue, and leaves one."""
    path = Path(20 * _MBIT, 0.01)
    got = beside(path, seconds=40.0, late_s=late_s, count=1, congestion=congestion, other=other)
    assert got.ours[0] >= 0.15 * 20 * _MBIT, got
    assert got.other >= 0.2 * 20 * _MBIT, got


@pytest.mark.parametrize("count", [1, pytest.param(2, marks=pytest.mark.slow)])
@pytest.mark.parametrize("congestion", ["open", "cubic"])
def test_others_who_leave(congestion: str, count: int) -> None:
    """Once who filled the link has gone it is full all the same, and its queue goes too."""
    path = Path(100 * _MBIT, 0.01)
    ours = Crowd(path, count=count, congestion=congestion, other="cubic")
    ours.run(3.0)
    ours.filling = True
    ours.run(12.0)
    ours.filling = False
    ours.run(6.0)
    got = ours.run(4.0)
    assert sum(got.ours) >= 0.9 * path.rate * _GOODPUT, got
    assert got.queue_s <= 0.25 * 2 * path.delay_s + 0.01, got


@pytest.mark.parametrize("mbit", [5, 10, 20])
def test_a_burst_next_to_us(mbit: float) -> None:
    """A link next to us that lets a burst through at once before it is slow has no long queue, not even at first."""
    path, burst_s = Path(mbit * _MBIT, 3e-5, burst_bytes=64_000), 64_000 / (mbit * _MBIT)
    clock = Clock()
    tcp, model = Tcp(clock, path), LinkModel()
    tcp.rtt = 2 * path.delay_s  # the first packets pass at once
    waits: list[float] = []

    def sample() -> None:
        waits.append(path.queue_s(clock.now))
        clock.at(clock.now + 0.001, sample)

    clock.at(0.0, lambda: images(clock, tcp, model, 305_000, 30))
    clock.at(0.0, sample)
    clock.run(4.0)
    assert max(waits) <= 0.5 * burst_s, max(waits)
    assert max(waits[1000:]) <= 2 * (4096 + SEGMENT_BYTES) / path.rate, max(waits[1000:])
    assert tcp.delivered >= 0.9 * 4.0 * path.rate * _GOODPUT


def test_a_round_trip_that_is_smoothed() -> None:
    """A queue that has gone is no queue of others, though the smoothed round trip, as little arrives, still has it."""
    model = LinkModel()
    model.observe(LinkReading(0.0, 0, 0, 0, 5e-5, 0.0, 0, SEGMENT_BYTES))
    now, delivered, rtt = 0.1, 0, 0.03
    for _ in range(20):  # 64 KiB on a link of 1 MB/s
        model.handed(1 << 20)
        model.observe(LinkReading(now, delivered, 64_000, 10_000, rtt, 0.0, 0, SEGMENT_BYTES))
        now, delivered = now + 0.002, delivered + 2_000
    for i in range(60):  # and then a few segments at a time
        in_flight = 3 * SEGMENT_BYTES if i % 4 else 0
        model.handed(1 << 20)
        model.observe(LinkReading(now, delivered, in_flight, 0, rtt, 0.0, 0, SEGMENT_BYTES))
        now, delivered, rtt = now + 0.003, delivered + 2 * SEGMENT_BYTES, rtt * 63 / 64
    assert model.base_rtt_s == 5e-5
    assert model.window_bytes <= 8 * SEGMENT_BYTES


def reading(now: float, delivered: int, *, rtt: float = 0.02, lost: int = 0, unsent: int = 0) -> LinkReading:
    """A reading of a link on which much is on the way."""
    return LinkReading(now, delivered, 50_000, unsent, rtt, 0.0, lost, SEGMENT_BYTES)


def test_losses_without_a_queue() -> None:
    """Losses on a link without a queue say that it is no full link that loses; with a queue, or rare, they do not."""
    for rtt, every, losing in ((0.02, 1, True), (0.2, 1, False), (0.02, 20, False)):
        model = LinkModel()
        model.observe(reading(0.0, 0))
        for i in range(1, 60):
            model.observe(reading(0.1 * i, 100_000 * i, rtt=rtt, lost=i // every, unsent=1 << 20))
        assert model.losing is losing


def test_the_pace_next_to_us() -> None:
    """Next to us the pace is not known until the link was seen full: what is slow there is how fast we send."""
    for rtt, known in ((0.0001, False), (0.02, True)):
        model = LinkModel()
        for i in range(60):
            model.observe(reading(0.01 * i, 100_000 * i, rtt=rtt))
        assert model.starting
        assert (model.bytes_per_s is not None) is known


def test_looks_that_come_late() -> None:
    """Where the kernel has run dry whenever we look, it may hold more; later, when we look in time, less again."""
    model = LinkModel()
    model.starting = False
    model.pace.carried(1_000_000, 1.0)
    limits = []
    for i in range(400):
        late = i < 100
        model.handed(1 << 20)
        model.observe(reading(0.01 * i, 10_000 * i, unsent=0 if late else 4096))
        limits.append(model.unsent_limit_bytes)
    assert limits[99] > limits[0]
    assert limits[-1] < limits[99]
