"""ropeway.group.exchange: each request is answered once."""

from __future__ import annotations

from ropeway.graph.base import Undelivered
from ropeway.group.exchange import Exchange
from ropeway.group.scheduler import Scheduler


def make() -> tuple[Exchange, Scheduler]:
    scheduler = Scheduler(["a", "b"])
    for name in ("a", "b"):
        scheduler.came(name, 0.0)
    exchange = Exchange(scheduler)
    exchange.read_by("the robot")
    return exchange, scheduler


def test_the_first_answer_counts() -> None:
    """Of two members that were asked, the answer that comes first is delivered, and the other is not."""
    exchange, scheduler = make()
    exchange.asked(("a", "b"), "r1", b"1", 0.0)
    assert exchange.came("b", b"1", 0.01) is None
    assert exchange.came("a", b"1", 0.03) is Undelivered.ANSWERED
    assert not exchange.is_open("r1")
    for name, latency in (("a", 0.03), ("b", 0.01)):
        found = scheduler.window(name).statistics(0.03)
        assert found is not None
        assert found.max == latency


def test_an_older_answer_is_outdated() -> None:
    """After a change, an answer of the old member to an older request than the last one answered is of no use."""
    exchange, scheduler = make()
    exchange.asked(("a",), "r1", b"1", 0.0)
    scheduler.switch("b", 0.005)
    exchange.asked(("b",), "r2", b"2", 0.01)
    assert exchange.came("b", b"2", 0.02) is None
    assert exchange.came("a", b"1", 0.03) is Undelivered.OUTDATED


def test_answers_of_the_old_member() -> None:
    """Requests that were under way at a change are still answered by whom they were sent to."""
    exchange, scheduler = make()
    exchange.asked(("a",), "r1", b"1", 0.0)
    exchange.asked(("a",), "r2", b"2", 0.01)
    scheduler.switch("b", 0.015)
    assert exchange.came("a", b"1", 0.02) is None
    assert exchange.came("a", b"2", 0.03) is None


def test_unasked() -> None:
    """Unasked messages count from the one in use, and after a change from the old one until the new one speaks."""
    exchange, scheduler = make()
    assert exchange.came("a", None, 0.0) is None
    assert exchange.came("b", None, 0.0) is Undelivered.STANDBY
    scheduler.switch("b", 0.1)
    assert exchange.came("a", None, 0.2) is None
    assert exchange.came("b", None, 0.3) is None
    assert exchange.came("a", None, 0.4) is Undelivered.STANDBY


def test_a_lost_member_answers_nothing() -> None:
    """The requests of a member that has gone are forgotten with it."""
    exchange, scheduler = make()
    exchange.asked(("a",), "r1", b"1", 0.0)
    scheduler.left("a", 0.1)
    exchange.forget("a")
    assert exchange.came("a", b"1", 0.2) is Undelivered.STANDBY


def test_bounded() -> None:
    """However many requests are never answered, a bounded number is remembered."""
    exchange, _ = make()
    for i in range(5000):
        exchange.asked(("a",), i, None, i * 0.001)
    assert not exchange.is_open(0)
    assert exchange.is_open(4999)


def test_nobody_reads_the_answers() -> None:
    """Requests whose answers nobody reads are not late, and those with a stamp are answered all the same later."""
    exchange, scheduler = make()
    reader = "the robot"
    exchange.asked(("a",), "r1", b"1", 0.0)
    exchange.asked(("a",), "r2", None, 0.0)
    assert scheduler.window("a").in_flight == 2
    exchange.unread_by(reader)
    exchange.asked(("a",), "r3", b"3", 0.1)
    exchange.asked(("a",), "r4", None, 0.1)
    assert scheduler.window("a").in_flight == 0
    assert scheduler.window("a").statistics(9.0) is None
    exchange.read_by(reader)
    exchange.asked(("a",), "r5", b"5", 10.0)
    assert exchange.came("a", b"3", 10.1) is None
    assert exchange.came("a", b"5", 10.1) is None
    found = scheduler.window("a").statistics(10.1)
    assert found is not None and found.answered == 1
