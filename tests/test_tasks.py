"""ropeway.tasks: background work that never dies unseen."""

from __future__ import annotations

import asyncio
import logging
import threading

import pytest

from ropeway.aio import ExceptionGroup
from ropeway.errors import GraphUnavailable
from ropeway.tasks import Chores, Supervised, background, describe, end, failing, keep_running, settled
from tests.support.until import until


async def test_supervised_work_is_started_again(caplog: pytest.LogCaptureFixture) -> None:
    """Work that fails says why in its error, the process-wide list and the log, and is started again until it works."""
    runs = 0
    failed: list[BaseException] = []
    may_work = asyncio.Event()

    async def work() -> None:
        nonlocal runs
        runs += 1
        if not may_work.is_set():
            raise KeyError("x")
        await asyncio.Event().wait()

    task = Supervised(work, "the work", on_failure=failed.append, pause_s=0.01, longest_pause_s=0.02).start()
    await until(lambda: runs > 3)
    assert task.error == "KeyError: 'x'"
    assert {"task": "the work", "error": "KeyError: 'x'", "failures": task.failures} in failing()
    may_work.set()
    await until(lambda: not task.error)
    assert not failing()
    assert len(failed) == task.failures
    told = [record for record in caplog.records if record.levelno >= logging.WARNING]
    assert [record.getMessage() for record in told] == ["the work failed: KeyError: 'x'; it is started again in 0.01 s"]
    assert told[0].exc_info is not None
    await task.close()


async def test_supervised_work_that_is_done() -> None:
    """Work that returns is done, and whoever waits for it goes on."""
    runs = 0

    async def work() -> None:
        nonlocal runs
        runs += 1

    task = Supervised(work, "the work").start()
    await task.wait()
    assert (runs, task.failures) == (1, 0)
    await task.close()


async def test_supervised_work_ended_before_its_first_step() -> None:
    """Work that is ended at once leaves nothing that was never awaited."""

    async def work() -> None:
        raise AssertionError

    task = Supervised(work, "the work").start()
    await task.close()
    assert task.failures == 0


async def test_work_that_cannot_even_be_called() -> None:
    """A failure to begin is a failure of the work, not of its owner."""
    calls = 0

    def work() -> None:
        nonlocal calls
        calls += 1
        raise GraphUnavailable("dds:0", "is not open")

    task = Supervised(work, "the work", pause_s=0.01).start()  # type: ignore[arg-type]
    await until(lambda: task.failures > 1)
    assert task.error == "dds:0: is not open"
    await task.close()
    assert not failing()


async def test_a_thread_is_kept_running() -> None:
    """Work in a thread is started again as work in a task is, and ends when it returns or its owner wants it to."""
    stopping, runs = threading.Event(), 0

    def work() -> None:
        nonlocal runs
        runs += 1
        if runs < 3:
            raise OSError(5, "no luck")

    await asyncio.to_thread(keep_running, work, "the thread", stopping, pause_s=0.001)
    assert runs == 3

    def fail() -> None:
        raise ValueError("never")

    thread = asyncio.create_task(asyncio.to_thread(keep_running, fail, "the thread", stopping, pause_s=60.0))
    await until(lambda: failing() == [{"task": "the thread", "error": "ValueError: never", "failures": 1}])
    stopping.set()
    await thread
    assert not failing()


async def test_one_chore_fails_alone(caplog: pytest.LogCaptureFixture) -> None:
    """A chore that fails is logged with its name at once; the others go on, and end with their owner."""
    chores, ended = Chores(), asyncio.Event()

    async def fail() -> None:
        raise ValueError("bad\nvalue")

    async def last() -> None:
        try:
            await asyncio.Event().wait()
        finally:
            ended.set()

    chores.start(last(), "the last one")
    chores.start(fail(), "the bad one")
    await until(lambda: chores.failures == 1)
    assert "the bad one failed: ValueError: bad value" in caplog.messages
    assert len(chores.tasks) == 1
    await chores.close()
    assert ended.is_set()
    assert len(chores.tasks) == 0


async def test_chores_are_waited_for_and_cancelled() -> None:
    """Chores can be waited for as long as one likes, and cancelled without waiting."""
    chores, go = Chores(), asyncio.Event()
    await chores.wait()
    first = chores.start(go.wait(), "the first")
    await chores.wait(0.0)
    assert not first.done()
    go.set()
    await chores.wait()
    assert first.done()
    second = chores.start(asyncio.Event().wait(), "the second")
    chores.cancel()
    await chores.wait()
    assert second.cancelled()


async def test_work_in_the_background_fails_aloud(caplog: pytest.LogCaptureFixture) -> None:
    """Work that nobody waits for is logged when it fails, once, however it is ended afterwards."""
    seen: list[dict[str, object]] = []
    asyncio.get_running_loop().set_exception_handler(lambda _, context: seen.append(context))

    async def fail() -> None:
        raise KeyError("x")

    task = background(fail(), "the work")
    await until(task.done)
    await end(task)
    assert [text for text in caplog.messages if "failed" in text] == ["the work failed: KeyError: 'x'"]
    assert not seen


def test_describe() -> None:
    """An error of ours is told by its text, another one with its kind, a group by what is in it."""
    assert describe(GraphUnavailable("dds:0", "is not open")) == "dds:0: is not open"
    assert describe(KeyError("x")) == "KeyError: 'x'"
    assert describe(TimeoutError()) == "TimeoutError"
    assert describe(ExceptionGroup("many", [ValueError("a"), ValueError("a"), KeyError(1)])) == (
        "ValueError: a; KeyError: 1"
    )


async def test_settled_leaves_a_future_alone() -> None:
    """Waiting for a future ends with it, with the time, or with the waiter, whose end leaves the future alone."""
    loop = asyncio.get_running_loop()
    done: asyncio.Future[int] = loop.create_future()
    assert not await settled(done, 0.0)
    waiting = asyncio.create_task(settled(done))
    given_up = asyncio.create_task(settled(done, 60.0))
    await asyncio.sleep(0)
    await end(given_up)
    assert not done.done()
    done.set_result(7)
    assert await waiting
    assert await settled(done, 0.0)
    failed: asyncio.Future[int] = loop.create_future()
    failed.set_exception(ValueError("no"))
    assert await settled(failed)
    assert isinstance(failed.exception(), ValueError)
