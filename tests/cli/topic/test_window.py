"""The figures of hz, bw and delay, in the form that ``ros2`` prints."""

from __future__ import annotations

import pytest

from ropeway.cli.topic.window import Bandwidth, Delay, Rate, Spread
from ropeway.graph.base import Sample


def sample(stamp_ns: int, size: int = 0) -> Sample:
    """A message of this size, received at this time."""
    return Sample(bytes(size), "a/msg/B", stamp_ns, b"", 1)


def test_rate_of_an_even_stream() -> None:
    """Ten messages 100 ms apart are 10 Hz."""
    rate = Rate()
    for number in range(10):
        rate.add(sample(number * 100_000_000))
    reading = rate.read()
    assert reading is not None
    assert reading.text == "average rate: 10.000\n\tmin: 0.100s max: 0.100s std dev: 0.00000s window: 9"
    assert reading.json["rate_hz"] == pytest.approx(10)
    assert rate.read() is None


def test_rate_window_keeps_the_newest() -> None:
    """Only the intervals of the window count."""
    rate = Rate(2)
    for stamp in (0, 5, 6, 8):
        rate.add(sample(stamp * 1_000_000_000))
    reading = rate.read()
    assert reading is not None
    assert reading.json == {
        "rate_hz": pytest.approx(1 / 1.5),
        "mean_s": 1.5,
        "min_s": 1.0,
        "max_s": 2.0,
        "std_dev_s": 0.5,
        "window": 2,
    }


def test_rate_starts_again_when_the_clock_is_set_back() -> None:
    """A clock that goes back gives no negative interval."""
    rate = Rate()
    for stamp in (100, 200, 50, 60):
        rate.add(sample(stamp * 1_000_000))
    reading = rate.read()
    assert reading is not None
    assert reading.json["window"] == 1
    assert reading.json["min_s"] == pytest.approx(0.01)


@pytest.mark.parametrize(
    ("size", "text"),
    [
        (10, "15 B/s from 3 messages\n\tMessage size mean: 10 B min: 10 B max: 10 B"),
        (2_000, "3.00 KB/s from 3 messages\n\tMessage size mean: 2.00 KB min: 2.00 KB max: 2.00 KB"),
        (3_000_000, "4.50 MB/s from 3 messages\n\tMessage size mean: 3.00 MB min: 3.00 MB max: 3.00 MB"),
    ],
)
def test_bandwidth(size: int, text: str) -> None:
    """Three messages in two seconds, in the unit that fits."""
    bandwidth = Bandwidth(100, lambda: 2_000_000_000)
    assert bandwidth.read() is None
    for number in range(3):
        bandwidth.add(sample(number * 900_000_000, size))
    reading = bandwidth.read()
    assert reading is not None
    assert reading.text == text
    assert reading.json["bandwidth_Bps"] == pytest.approx(1.5 * size)


def test_delay_counts_only_messages_with_a_stamp() -> None:
    """The delay is from the header's stamp to the reception."""
    delay = Delay(10, lambda payload: len(payload) * 1_000_000 if payload else None)
    delay.add(sample(5_000_000))
    assert delay.read() is None
    delay.add(sample(5_000_000, 2))
    delay.add(sample(6_000_000, 1))
    reading = delay.read()
    assert reading is not None
    assert reading.text == "average delay: 0.004\n\tmin: 0.003s max: 0.005s std dev: 0.00100s window: 2"
    assert delay.read() is None


def test_spread_of_one_value() -> None:
    """One value has no deviation."""
    assert Spread.of([3.0]) == Spread(3.0, 3.0, 3.0, 0.0, 1)
