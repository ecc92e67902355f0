"""Messages that wait for a program."""

from __future__ import annotations

import asyncio

import pytest

from ropeway.api.inbox import Inbox
from ropeway.api.message import MessageType, TypedMessage
from ropeway.types import TypeRegistry

STRING = MessageType(TypeRegistry(), "std_msgs/String")


def message(text: str) -> TypedMessage:
    return STRING.message(STRING.encode({"data": text}))


async def test_the_oldest_go() -> None:
    """Above its number of messages the queue drops the oldest and counts them."""
    inbox = Inbox(2, 1 << 20)
    for text in "abc":
        inbox.put(message(text))
    assert [(await inbox.get())["data"], (await inbox.get())["data"]] == ["b", "c"]  # type: ignore[index]
    assert inbox.dropped == 1


async def test_bytes_are_bounded() -> None:
    """Above its number of bytes the queue drops the oldest, but never the newest."""
    inbox = Inbox(100, 1000)
    for text in ("a" * 400, "b" * 400, "c" * 400, "d" * 5000):
        inbox.put(message(text))
    assert (await inbox.get())["data"][0] == "d"  # type: ignore[index]
    assert inbox.dropped == 3


async def test_whoever_waits_is_told_of_the_end() -> None:
    """A closed queue gives nothing more, also to those who wait."""
    inbox = Inbox(2, 1 << 20)
    waiting = asyncio.create_task(inbox.get())
    await asyncio.sleep(0)
    inbox.put(message("a"))
    inbox.close()
    assert await waiting is None
    assert await inbox.get() is None


async def test_what_came_before_a_failure_is_given() -> None:
    """A failure is raised after the messages that came before it, until it is taken back."""
    inbox = Inbox(2, 1 << 20)
    inbox.put(message("a"))
    inbox.fail(ValueError("over"))
    assert await inbox.get() is not None
    with pytest.raises(ValueError, match="over"):
        await inbox.get()
    inbox.fail(None)
    inbox.put(message("b"))
    assert await inbox.get() is not None


async def test_finish_gives_the_rest() -> None:
    """A queue that is finished gives what it has, then nothing."""
    inbox = Inbox(2, 1 << 20)
    inbox.put(message("a"))
    inbox.finish()
    assert await inbox.get() is not None
    assert await inbox.get() is None
