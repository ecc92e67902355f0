"""The turns of a client's operations."""

from __future__ import annotations

import asyncio
from typing import Any

from ropeway.listener.turns import Turns


class Answers:
    """No answer waits."""

    count = 0
    on_gone: Any = None


class Counting:
    """A connection of which nothing is asked but what it has received."""

    bytes_in = 0

    def pause_reading(self) -> None: ...

    def resume_reading(self) -> None: ...


def make_turns() -> Turns[str]:
    """Return the turns of a client that has sent nothing."""
    connection: Any = Counting()
    return Turns(connection, Answers())


async def test_one_after_the_other() -> None:
    """Operations are carried out in their order, and wait until they have been."""
    turns, seen = make_turns(), list[tuple[str, int]]()

    async def do(op: str) -> None:
        seen.append((op, len(turns.waiting)))

    for op in "abc":
        turns.push(op)
    await turns.carry_out(do, lambda: len(seen) == 3)
    assert seen == [("a", 3), ("b", 2), ("c", 1)]
    assert not turns.waiting


async def test_a_client_that_leaves_in_the_middle() -> None:
    """A client that leaves while an operation is carried out ends that quietly, and what waits is left undone."""
    turns, seen, over = make_turns(), list[str](), False

    async def do(op: str) -> None:
        nonlocal over
        seen.append(op)
        await asyncio.sleep(0)
        over = True
        turns.forget()

    turns.push("a")
    turns.push("b")
    await turns.carry_out(do, lambda: over)
    assert seen == ["a"]
