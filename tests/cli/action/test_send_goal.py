"""``action send_goal`` without the terminal."""

from __future__ import annotations

import asyncio
import json
from typing import Any

import pytest

from ropeway.cli.action.send_goal import GoalReport, JsonTeller, TextTeller, send_goal
from ropeway.cli.session import OpenGraph
from ropeway.errors import GoalRejected, NotServed, ValueMismatch
from ropeway.graph.calls import ActionHandlers, GoalStatus, Outcome, ServerGoal
from ropeway.types import TypeRegistry
from tests.support.actions import FIBONACCI, sequence
from tests.support.until import until

pytestmark = pytest.mark.jumping

ID = bytes(range(16))


class Notes(GoalReport):
    """Keeps what is said."""

    def __init__(self) -> None:
        self.said: list[Any] = []

    def accepted(self, id: bytes) -> None:
        self.said.append("accepted")

    def feedback(self, payload: bytes) -> None:
        self.said.append(payload)

    def outcome(self, outcome: Outcome) -> None:
        self.said.append(outcome.status.name)


async def patient(goal: ServerGoal) -> Outcome:
    """Wait for the end."""
    await goal.cancelled.wait()
    return Outcome(GoalStatus.CANCELED, sequence(1))


async def test_succeeds(pair: tuple[OpenGraph, OpenGraph]) -> None:
    """A goal is sent, followed to its end, and its feedback told."""
    here, there = pair

    async def count(goal: ServerGoal) -> Outcome:
        goal.feedback(sequence(0))
        goal.feedback(sequence(0, 1))
        return Outcome(GoalStatus.SUCCEEDED, sequence(0, 1, 1))

    await there.graph.create_action_server("/count", FIBONACCI, ActionHandlers(count))
    notes = Notes()
    outcome = await send_goal(here, "/count", FIBONACCI, {"order": 3}, notes, timeout_s=5, feedback=True)
    assert outcome == Outcome(GoalStatus.SUCCEEDED, sequence(0, 1, 1))
    assert notes.said == ["accepted", sequence(0), sequence(0, 1), "SUCCEEDED"]
    quiet = Notes()
    await send_goal(here, "/count", "example_interfaces/Fibonacci", {"order": 3}, quiet, timeout_s=5)
    assert quiet.said == ["accepted", "SUCCEEDED"]


async def test_interrupted(pair: tuple[OpenGraph, OpenGraph], capsys: pytest.CaptureFixture[str]) -> None:
    """Ctrl-C cancels the goal and tells how it ends."""
    here, there = pair
    await there.graph.create_action_server("/count", FIBONACCI, ActionHandlers(patient))
    notes = Notes()
    sending = asyncio.create_task(send_goal(here, "/count", FIBONACCI, {}, notes, timeout_s=5))
    await until(lambda: notes.said == ["accepted"])
    sending.cancel()
    with pytest.raises(asyncio.CancelledError):
        await sending
    assert notes.said == ["accepted", "CANCELED"]
    assert capsys.readouterr().err == "Canceling goal...\n"


async def test_interrupted_before_acceptance(pair: tuple[OpenGraph, OpenGraph]) -> None:
    """Ctrl-C before the goal is accepted cancels it as soon as it is."""
    here, there = pair
    asked, decide = asyncio.Event(), asyncio.Event()

    async def accept(goal: ServerGoal) -> bool:
        asked.set()
        await decide.wait()
        return True

    await there.graph.create_action_server("/count", FIBONACCI, ActionHandlers(patient, accept))
    notes = Notes()
    sending = asyncio.create_task(send_goal(here, "/count", FIBONACCI, {}, notes, timeout_s=5))
    await asked.wait()
    sending.cancel()
    await asyncio.sleep(0)
    decide.set()
    with pytest.raises(asyncio.CancelledError):
        await sending
    assert notes.said == ["CANCELED"]


async def test_interrupted_in_vain(pair: tuple[OpenGraph, OpenGraph], capsys: pytest.CaptureFixture[str]) -> None:
    """Where the server does not end the goal, that is said."""
    here, there = pair

    async def stubborn(goal: ServerGoal) -> Outcome:
        await asyncio.Event().wait()
        raise AssertionError

    async def never(goal: ServerGoal) -> bool:
        return False

    for name, handlers in (("/a", ActionHandlers(stubborn)), ("/b", ActionHandlers(stubborn, cancel=never))):
        await there.graph.create_action_server(name, FIBONACCI, handlers)
        notes = Notes()
        sending = asyncio.create_task(send_goal(here, name, FIBONACCI, {}, notes, timeout_s=60))
        await until(lambda notes=notes: notes.said == ["accepted"])
        sending.cancel()
        with pytest.raises(asyncio.CancelledError):
            await sending
    assert capsys.readouterr().err == (
        "Canceling goal...\nFailed to cancel goal: the server has not ended it within 5 s\n"
        "Canceling goal...\nFailed to cancel goal: the server goes on with it\n"
    )


async def test_mistakes(pair: tuple[OpenGraph, OpenGraph]) -> None:
    """Wrong values, a missing server and a rejection are errors of their own."""
    here, there = pair

    async def never(goal: ServerGoal) -> bool:
        return False

    with pytest.raises(ValueMismatch):
        await send_goal(here, "/count", FIBONACCI, {"ordr": 3}, GoalReport(), timeout_s=5)
    with pytest.raises(NotServed):
        await send_goal(here, "/count", FIBONACCI, {}, GoalReport(), timeout_s=0.05)
    await there.graph.create_action_server("/count", FIBONACCI, ActionHandlers(patient, never))
    with pytest.raises(GoalRejected):
        await send_goal(here, "/count", FIBONACCI, {}, GoalReport(), timeout_s=5)


def test_text(registry: TypeRegistry, capsys: pytest.CaptureFixture[str]) -> None:
    """What is said is what ``ros2 action send_goal`` says."""
    teller = TextTeller(registry, FIBONACCI)
    teller.accepted(ID)
    teller.feedback(sequence(0, 1))
    teller.outcome(Outcome(GoalStatus.SUCCEEDED, sequence(2)))
    teller.outcome(Outcome(GoalStatus.ABORTED, None, "the server has gone"))
    assert capsys.readouterr().out == (
        "Goal accepted with ID: 000102030405060708090a0b0c0d0e0f\n\n"
        "Feedback:\n    sequence:\n    - 0\n    - 1\n\n"
        "Result:\n    sequence:\n    - 2\n\nGoal finished with status: SUCCEEDED\n"
        "Goal finished with status: ABORTED (the server has gone)\n"
    )


def test_json(registry: TypeRegistry, capsys: pytest.CaptureFixture[str]) -> None:
    """The JSON form has one object for each step."""
    teller = JsonTeller(registry, FIBONACCI)
    teller.accepted(ID)
    teller.feedback(sequence(0, 1))
    teller.outcome(Outcome(GoalStatus.SUCCEEDED, sequence(2)))
    teller.outcome(Outcome(GoalStatus.ABORTED, None, "gone"))
    assert [json.loads(line) for line in capsys.readouterr().out.splitlines()] == [
        {"accepted": True, "goal_id": ID.hex()},
        {"feedback": {"sequence": [0, 1]}},
        {"status": "SUCCEEDED", "code": 4, "result": {"sequence": [2]}, "text": ""},
        {"status": "ABORTED", "code": 6, "result": None, "text": "gone"},
    ]
