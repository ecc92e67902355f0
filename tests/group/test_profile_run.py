"""ropeway.group.profile_run: who is asked at the start, and when it is over."""

from __future__ import annotations

from ropeway.group.options import Options
from ropeway.group.profile_run import ProfileRun


def test_in_turns() -> None:
    """Members are asked in turns, each within its share of the time."""
    run = ProfileRun(["a", "b", "c"], 0.0, Options(), 0.03)
    asked = []
    for i in range(29):
        asked.append(run.next(i * 0.01))
        run.asked(asked[-1], i * 0.01)
    assert asked[:6] == ["a", "b", "c", "a", "b", "c"]
    assert run.next(0.301) == ""


def test_everybody_is_asked_once() -> None:
    """Where requests are rarer than the time for each, every member gets one all the same."""
    run = ProfileRun(["a", "b"], 0.0, Options(), None)
    run.asked(run.next(0.0), 0.0)
    assert run.next(5.0) == "b"
    assert not run.over(5.0)
    run.asked("b", 5.0)
    assert run.next(6.0) == ""


def test_answers_are_waited_for() -> None:
    """It is over once half of the answers are there, or after a time in which they ought to have come."""
    run = ProfileRun(["a", "b"], 0.0, Options(), 0.4)
    run.asked("a", 0.0)
    run.asked("b", 0.1)
    run.answered("a")
    assert not run.over(0.3)
    run.answered("b")
    assert run.over(0.3)
    silent = ProfileRun(["a", "b"], 0.0, Options(), 0.4)
    silent.asked("a", 0.0)
    silent.asked("b", 0.1)
    assert not silent.over(0.9)
    assert silent.over(1.1)


def test_members_come_and_go() -> None:
    """A member that comes is asked, too, and one that is gone is neither asked nor waited for."""
    run = ProfileRun(["a", "b"], 0.0, Options(), None)
    run.joined("c")
    run.left("a")
    for _ in range(2):
        run.asked(run.next(0.1), 0.1)
    assert run.names == ("b", "c")
    run.left("b")
    run.left("c")
    assert run.next(0.1) == "" and run.over(9.0)
