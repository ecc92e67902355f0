"""ropeway.delivery.pacing.pace and ropeway.delivery.encoding_choice."""

from __future__ import annotations

import pytest

from ropeway.delivery.encoding_choice import EncodingChooser
from ropeway.delivery.pacing.pace import Pace


class Clock:
    def __init__(self) -> None:
        self.now = 100.0

    def __call__(self) -> float:
        return self.now


def paced(clock: Clock, bytes_per_s: float, size: int = 300_000) -> Pace:
    pace = Pace()
    for _ in range(10):
        pace.carried(size, size / bytes_per_s)
    return pace


def rows(pace: Pace, rate: float, size: int, *, busy: bool, times: int = 1, begin_s: float = 0.0) -> float:
    """Bursts of ``size`` bytes that arrive at ``rate``, 0.1 s apart; gives the time after them."""
    now, delivered = begin_s, int(begin_s * 1e9)
    for _ in range(times):
        left = size
        while left > 0:
            step = min(left, max(int(rate * 0.002), 1500))
            now += step / rate
            delivered += step
            left -= step
            pace.observe(now, delivered, in_flight_bytes=left, busy=busy, segment_bytes=1448)
        now += 0.1
    return now


def test_unknown_at_first() -> None:
    """Before anything was sent the pace of a link is unknown, and a few packets do not show it."""
    pace = Pace()
    assert pace.bytes_per_s is None
    rows(pace, 1e6, 5000, busy=True)
    assert pace.bytes_per_s is None


@pytest.mark.parametrize("rate", [0.6e6, 2.5e6, 12.5e6])
def test_bursts_show_the_pace(rate: float) -> None:
    """Bursts show the pace of a link that is idle in between."""
    pace = Pace()
    rows(pace, rate, 300_000, busy=False, times=10)
    assert pace.bytes_per_s == pytest.approx(rate, rel=0.1)


def test_a_sender_that_sends_little_says_nothing_of_the_link() -> None:
    """What arrives slowly because it was sent slowly does not lower the pace; on a busy link it does."""
    pace = Pace()
    now = rows(pace, 12.5e6, 300_000, busy=False, times=10)
    now = rows(pace, 1e6, 300_000, busy=False, times=10, begin_s=now)
    assert pace.bytes_per_s == pytest.approx(12.5e6, rel=0.1)
    rows(pace, 1e6, 300_000, busy=True, times=10, begin_s=now)
    assert pace.bytes_per_s == pytest.approx(1e6, rel=0.1)


def test_a_faster_link_shows() -> None:
    """A burst that arrives faster raises the pace, also of a link that is not busy."""
    pace = Pace()
    now = rows(pace, 1e6, 300_000, busy=True, times=10)
    rows(pace, 12.5e6, 300_000, busy=False, times=10, begin_s=now)
    assert pace.bytes_per_s == pytest.approx(12.5e6, rel=0.1)


def test_raw_on_a_fast_link() -> None:
    """Without a known pace messages go raw."""
    assert EncodingChooser(Pace()).choose(300_000, 0, 0) == "cbor-raw"


def test_compresses_where_it_pays() -> None:
    """On a slow link a topic that compresses well goes compressed, one that does not goes raw."""
    clock = Clock()
    pace = paced(clock, 12.5e6)
    good, bad = EncodingChooser(pace, clock), EncodingChooser(pace, clock)
    assert good.choose(300_000, 0, 0) == bad.choose(300_000, 0, 0) == "zstd"  # the first one is a trial
    good.measured(300_000, 150_000, 0.0005)
    bad.measured(300_000, 298_000, 0.0005)
    assert good.choose(300_000, 0, 0) == "zstd"
    assert bad.choose(300_000, 0, 0) == "cbor-raw"


def test_small_messages_go_raw() -> None:
    """A message that takes less than a millisecond on the wire is not worth compressing."""
    clock = Clock()
    chooser = EncodingChooser(paced(clock, 12.5e6), clock)
    assert chooser.choose(1000, 0, 0) == "cbor-raw"


def test_raw_again_when_the_link_is_faster() -> None:
    """When the pace rises so that compression costs more than it saves, the topic goes raw again."""
    clock = Clock()
    pace = paced(clock, 12.5e6)
    chooser = EncodingChooser(pace, clock)
    chooser.choose(300_000, 0, 0)
    chooser.measured(300_000, 200_000, 0.001)
    assert chooser.choose(300_000, 0, 0) == "zstd"
    for _ in range(20):
        pace.carried(10**7, 10**7 / 200e6)
    assert chooser.choose(300_000, 0, 0) == "cbor-raw"


@pytest.mark.parametrize(("raw_hz", "packed_hz", "best"), [(250, 80, "cbor-raw"), (25, 60, "zstd")])
def test_what_gets_through_decides(raw_hz: float, packed_hz: float, best: str) -> None:
    """While messages are lost, the encoding that really brings more through is used nearly all the time."""
    clock = Clock()
    chooser = EncodingChooser(Pace(), clock)
    chooser.ratio = 3.0
    sent = lost = 0.0
    used = []
    for _ in range(3000):
        encoding = chooser.choose(300_000, int(sent), int(lost))
        used.append(encoding)
        clock.now += 0.01
        rate = raw_hz if encoding == "cbor-raw" else packed_hz
        sent += 0.01 * rate
        lost += 0.01 * (500 - rate)
    assert used[-500:].count(best) > 400
    assert used.count(best) > 2500


def test_a_slow_link_is_not_tried_raw() -> None:
    """Where the link has no room for more raw messages than go through compressed, raw gets no turn."""
    clock = Clock()
    pace = paced(clock, 1.19e6)
    chooser = EncodingChooser(pace, clock)
    chooser.choose(305_000, 0, 0)
    chooser.measured(305_000, 95_000, 0.001)
    sent = lost = 0.0
    used = []
    for _ in range(2000):
        encoding = chooser.choose(305_000, int(sent), int(lost))
        used.append(encoding)
        clock.now += 0.01
        rate = 3.9 if encoding == "cbor-raw" else 11.0
        sent += 0.01 * rate
        lost += 0.01 * (30 - rate)
    assert used.count("zstd") > 1990
