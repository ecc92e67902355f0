"""Calling a program's functions with messages."""

from __future__ import annotations

import asyncio
import functools
from typing import Any

import pytest

from ropeway import TypedMessage
from ropeway.api.callbacks import Callbacks
from ropeway.api.inbox import Inbox
from ropeway.api.message import MessageType
from ropeway.types import TypeRegistry

STRING = MessageType(TypeRegistry(), "std_msgs/String")


def message(text: str) -> TypedMessage:
    return STRING.message(STRING.encode({"data": text}))


class Listener:
    """An object that is called, as a coroutine."""

    def __init__(self) -> None:
        self.found: list[str] = []

    async def __call__(self, message: TypedMessage) -> None:
        await asyncio.sleep(0)
        self.found.append(message["data"])


async def test_function_is_called_at_once() -> None:
    """A function is called before ``put`` returns."""
    found: list[str] = []
    callbacks = Callbacks(lambda message: found.append(message["data"]), Inbox(10, 1000), "/a")
    callbacks.put(message("a"))
    assert found == ["a"]
    await callbacks.close()


@pytest.mark.parametrize("form", ["function", "object", "partial"])
async def test_coroutine_gets_one_at_a_time(form: str) -> None:
    """A coroutine function, also as an object or a partial, gets what has come, in order, before it is finished."""
    listener = Listener()

    async def take(to: Listener, message: TypedMessage) -> None:
        await to(message)

    async def function(message: TypedMessage) -> None:
        await listener(message)

    callback: Any = {"function": function, "object": listener, "partial": functools.partial(take, listener)}[form]
    callbacks = Callbacks(callback, Inbox(10, 1000), "/a")
    for text in "abc":
        callbacks.put(message(text))
    await callbacks.finish()
    assert listener.found == ["a", "b", "c"]
    await callbacks.close()


async def test_failures_are_told(caplog: pytest.LogCaptureFixture) -> None:
    """A failure is told and logged, and does not keep the next message."""
    failures: list[int] = []

    async def fail(message: TypedMessage) -> None:
        raise ValueError(message["data"])

    callbacks = Callbacks(fail, Inbox(10, 1000), "/a", lambda: failures.append(1))
    callbacks.put(message("a"))
    callbacks.put(message("b"))
    await callbacks.finish()
    assert len(failures) == 2
    assert caplog.text.count("the callback for /a failed") == 2


async def test_lambda_around_a_coroutine(caplog: pytest.LogCaptureFixture) -> None:
    """A function that only makes a coroutine would do nothing, which is told."""
    listener = Listener()
    failures: list[int] = []
    callbacks = Callbacks(lambda message: listener(message), Inbox(10, 1000), "/a", lambda: failures.append(1))
    callbacks.put(message("a"))
    assert failures == [1]
    assert "give the coroutine function itself" in caplog.text
    await callbacks.close()


async def test_close_ends_a_callback() -> None:
    """Closing cancels a callback that is under way."""
    began, ended = asyncio.Event(), asyncio.Event()

    async def wait(message: TypedMessage) -> None:
        began.set()
        try:
            await asyncio.Event().wait()
        finally:
            ended.set()

    callbacks = Callbacks(wait, Inbox(10, 1000), "/a")
    callbacks.put(message("a"))
    await began.wait()
    await callbacks.close()
    assert ended.is_set()
