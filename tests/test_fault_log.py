"""ropeway.fault_log."""

from __future__ import annotations

import pytest

from ropeway.fault_log import FaultLog


class Clock:
    def __init__(self) -> None:
        self.now = 100.0

    def __call__(self) -> float:
        return self.now


def test_counts_everything_and_logs_once_a_minute(caplog: pytest.LogCaptureFixture) -> None:
    """Every fault counts by kind and topic; each kind is logged once a minute, with peer and topic."""
    clock = Clock()
    complaints = FaultLog("10.0.0.7:5000", clock)
    for second in range(59):
        clock.now = 100.0 + second
        complaints.note("message", "/imu", "field x: not a number")
        complaints.note("message", "/odom", "cut off")
    complaints.note("frame", "", "not JSON")
    assert complaints.counts == {("message", "/imu"): 59, ("message", "/odom"): 59, ("frame", ""): 1}
    assert complaints.total == 119
    assert caplog.messages == [
        "10.0.0.7:5000: bad message on /imu: field x: not a number",
        "10.0.0.7:5000: bad frame: not JSON",
    ]
    clock.now += 60
    complaints.note("message", "/odom", "cut off")
    complaints.note("message", "/odom", "cut off")
    assert caplog.messages[2:] == ["10.0.0.7:5000: bad message on /odom: cut off (117 more since the last such line)"]


def test_many_topics(caplog: pytest.LogCaptureFixture) -> None:
    """A peer that invents topics fills neither the table nor the log."""
    complaints = FaultLog("peer")
    for i in range(100_000):
        complaints.note("unknown topic", f"/t{i}", "it was not advertised")
    assert len(complaints.counts) < 2000
    assert complaints.total == 100_000
    assert len(caplog.messages) == 1


def test_long_and_odd_texts(caplog: pytest.LogCaptureFixture) -> None:
    """What a peer sends is kept and logged in short, on one line, without control characters."""
    complaints = FaultLog("peer")
    complaints.note("operation", "/x" * 10_000_000, "y" * 10_000_000)
    complaints.note("frame", "\x1b[2J\nroot: all is well", "\udc80 half a character")
    ((_, long), (_, odd)) = complaints.counts
    assert len(long) == 200
    assert odd == r"\x1b[2J\nroot: all is well"
    assert all(len(line) < 1000 and line.isprintable() for line in caplog.messages)
