"""Actions that count, and actions that wait."""

from __future__ import annotations

import asyncio
import struct
from typing import Final

from ropeway.graph.calls import GoalStatus, Outcome, ServerGoal

__all__ = ["FIBONACCI", "Worker", "count", "order", "ordered", "sequence"]

FIBONACCI: Final = "example_interfaces/action/Fibonacci"


def order(value: int) -> bytes:
    """Return a Fibonacci_Goal as CDR."""
    return b"\0\1\0\0" + struct.pack("<i", value)


def sequence(*values: int) -> bytes:
    """Return a Fibonacci_Result or Fibonacci_Feedback as CDR."""
    return b"\0\1\0\0" + struct.pack(f"<I{len(values)}i", len(values), *values)


def ordered(goal: ServerGoal) -> int:
    """Return the number in a goal."""
    return int(struct.unpack("<i", goal.payload[4:8])[0])


async def count(goal: ServerGoal) -> Outcome:
    """Count up to the order, with feedback of each step."""
    for step in range(ordered(goal)):
        goal.feedback(sequence(*range(step + 1)))
    return Outcome(GoalStatus.SUCCEEDED, sequence(*range(ordered(goal))))


class Worker:
    """An action that does what the test says."""

    def __init__(self) -> None:
        self.goals: list[ServerGoal] = []
        self.finish = asyncio.Event()

    async def __call__(self, goal: ServerGoal) -> Outcome:
        self.goals.append(goal)
        cancelled, finished = asyncio.ensure_future(goal.cancelled.wait()), asyncio.ensure_future(self.finish.wait())
        try:
            await asyncio.wait({cancelled, finished}, return_when=asyncio.FIRST_COMPLETED)
        finally:
            cancelled.cancel()
            finished.cancel()
        if goal.cancelled.is_set():
            return Outcome(GoalStatus.CANCELED, sequence(5))
        return Outcome(GoalStatus.SUCCEEDED, sequence(4))
