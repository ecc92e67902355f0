"""ropeway.link.pace and ropeway.link.auto."""

from __future__ import annotations

import pytest

from ropeway.link.auto import EncodingChooser
from ropeway.link.pace import Pace


class Clock:
    def __init__(self) -> None:
        self.now = 100.0

    def __call__(self) -> float:
        return self.now


def paced(clock: Clock, bytes_per_s: float, size: int = 300_000) -> Pace:
    pace = Pace(clock)
    for _ in range(10):
        pace.carried(size, size / bytes_per_s)
    return pace


def test_unknown_until_busy() -> None:
    """A link that never held anything back has no known pace."""
    assert Pace().bytes_per_s is None


def test_measures_a_busy_link() -> None:
    """The pace is what the link carried away while it was busy."""
    assert paced(Clock(), 12.5e6).bytes_per_s == pytest.approx(12.5e6)


def test_follows_a_change() -> None:
    """After a few tenths of a busy second the pace is that of the link as it is now."""
    pace = paced(Clock(), 12.5e6)
    for _ in range(10):
        pace.carried(100_000, 100_000 / 1.25e6)
    assert pace.bytes_per_s == pytest.approx(1.25e6, rel=0.2)
    for _ in range(100):
        pace.carried(100_000, 100_000 / 125e6)
    assert pace.bytes_per_s == pytest.approx(125e6, rel=0.7)


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
    chooser = EncodingChooser(Pace(clock), clock)
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
