"""ropeway.aio310: what Python 3.10 lacks, held against what newer ones have. These tests run on every Python."""

from __future__ import annotations

import asyncio
import os
import signal
from collections.abc import Callable
from typing import Any

import pytest

from ropeway import aio, aio310
from ropeway.aio import BaseExceptionGroup, ExceptionGroup

BOTH = pytest.mark.parametrize("module", [aio310, aio], ids=["ours", "python"])


@BOTH
async def test_a_block_whose_time_is_over(module: Any) -> None:
    """A block that is too slow raises TimeoutError, says that it expired, and leaves no cancellation behind."""
    with pytest.raises(TimeoutError):
        async with module.timeout(0) as limit:
            await asyncio.Event().wait()
    assert limit.expired()
    await asyncio.sleep(0)


@BOTH
async def test_a_block_that_is_done_in_time(module: Any) -> None:
    """A block that is done in time ends as without a limit, and nothing comes later."""
    async with module.timeout(0.01) as limit:
        pass
    await asyncio.sleep(0.02)
    async with module.timeout(None) as none:
        await asyncio.sleep(0)
    assert not limit.expired()
    assert none.when() is None


@BOTH
async def test_a_block_that_is_given_more_time(module: Any) -> None:
    """A block goes on when its end is put off, and ends when it is put to now."""
    loop = asyncio.get_running_loop()
    with pytest.raises(TimeoutError):
        async with module.timeout_at(loop.time() + 0.01) as limit:
            limit.reschedule(None)
            await asyncio.sleep(0.03)
            assert not limit.expired()
            limit.reschedule(loop.time())
            await asyncio.Event().wait()


@BOTH
async def test_limits_within_limits(module: Any) -> None:
    """The limit whose time is over is the one that raises, whether it is the inner or the outer."""
    async with module.timeout(60):
        with pytest.raises(TimeoutError):
            async with module.timeout(0):
                await asyncio.Event().wait()
    with pytest.raises(TimeoutError):
        async with module.timeout(0) as outer, module.timeout(60) as inner:
            await asyncio.Event().wait()
    assert (outer.expired(), inner.expired()) == (True, False)


@BOTH
async def test_a_cancellation_of_others_stays_one(module: Any) -> None:
    """A task that is cancelled from elsewhere while its time is over is cancelled, not late."""
    expiring = asyncio.Event()

    async def work() -> None:
        async with module.timeout(0):
            try:
                await asyncio.Event().wait()
            finally:
                expiring.set()
                await asyncio.Event().wait()

    task = asyncio.create_task(work())
    await expiring.wait()
    task.cancel()
    with pytest.raises(asyncio.CancelledError):
        await task
    assert task.cancelled()


@BOTH
async def test_an_error_of_the_block_is_told(module: Any) -> None:
    """An error that the block raises while its time is over comes out as it is."""
    with pytest.raises(KeyError):
        async with module.timeout(0):
            try:
                await asyncio.Event().wait()
            except asyncio.CancelledError:
                raise KeyError("x") from None


@BOTH
async def test_a_group_waits_for_its_tasks(module: Any) -> None:
    """A group is over when all its tasks are, also those that its tasks made."""
    done: list[int] = []

    async def step(number: int) -> None:
        await asyncio.sleep(0)
        done.append(number)
        if number:
            group.create_task(step(number - 1), name="next")

    async with module.TaskGroup() as group:
        group.create_task(step(3))
    assert done == [3, 2, 1, 0]
    late = step(0)
    with pytest.raises(RuntimeError):
        group.create_task(late)
    late.close()


@BOTH
async def test_a_task_that_fails_ends_its_group(module: Any) -> None:
    """The first task that fails ends the others and the block, and the group raises what failed, and only that."""
    ended: list[str] = []

    async def fail() -> None:
        raise KeyError("x")

    async def stay(name: str) -> None:
        try:
            await asyncio.Event().wait()
        except asyncio.CancelledError:
            ended.append(name)
            raise

    with pytest.raises(ExceptionGroup) as raised:
        async with module.TaskGroup() as group:
            group.create_task(stay("task"))
            group.create_task(fail())
            await stay("block")
    assert [type(error) for error in raised.value.exceptions] == [KeyError]
    assert sorted(ended) == ["block", "task"]
    await asyncio.sleep(0)


@BOTH
async def test_a_block_of_a_group_that_fails(module: Any) -> None:
    """An error of the block ends the tasks and is among what the group raises, beside the tasks' own."""

    async def fail_late() -> None:
        try:
            await asyncio.Event().wait()
        except asyncio.CancelledError:
            raise ValueError("late") from None

    with pytest.raises(BaseExceptionGroup) as raised:
        async with module.TaskGroup() as group:
            group.create_task(fail_late())
            await asyncio.sleep(0)
            raise KeyError("block")
    assert {type(error) for error in raised.value.exceptions} == {KeyError, ValueError}


@BOTH
async def test_a_group_that_is_cancelled(module: Any) -> None:
    """A group whose task is cancelled ends its tasks, and the cancellation goes on; a limit around it still tells."""
    ended = asyncio.Event()

    async def stay() -> None:
        try:
            await asyncio.Event().wait()
        finally:
            ended.set()

    async def whole() -> None:
        async with module.TaskGroup() as group:
            group.create_task(stay())

    task = asyncio.create_task(whole())
    await asyncio.sleep(0)
    await asyncio.sleep(0)
    task.cancel()
    with pytest.raises(asyncio.CancelledError):
        await task
    assert ended.is_set()
    with pytest.raises(TimeoutError):
        async with module.timeout(0), module.TaskGroup() as group:
            group.create_task(stay())


@BOTH
def test_a_runner(module: Any) -> None:
    """A runner gives the result on a loop of the given kind, and at its end cancels what is left."""
    made: list[asyncio.AbstractEventLoop] = []
    left: list[asyncio.Task[Any]] = []

    def factory() -> asyncio.AbstractEventLoop:
        made.append(asyncio.new_event_loop())
        return made[0]

    async def main() -> int:
        left.append(asyncio.create_task(asyncio.Event().wait()))
        await asyncio.sleep(0)
        assert asyncio.get_running_loop() is made[0]
        return 7

    with module.Runner(loop_factory=factory) as runner:
        assert runner.run(main()) == 7
    assert left[0].cancelled()
    assert made[0].is_closed()


@BOTH
def test_ctrl_c(module: Any, capfd: pytest.CaptureFixture[str]) -> None:
    """Ctrl-C cancels what runs, which may clean up, and then comes out as KeyboardInterrupt."""
    cleaned: list[bool] = []

    async def main() -> None:
        asyncio.get_running_loop().call_soon(os.kill, os.getpid(), signal.SIGINT)
        try:
            await asyncio.Event().wait()
        finally:
            await asyncio.sleep(0)
            cleaned.append(True)

    with pytest.raises(KeyboardInterrupt), module.Runner() as runner:
        runner.run(main())
    assert cleaned == [True]
    assert signal.getsignal(signal.SIGINT) is signal.default_int_handler


@BOTH
async def test_what_is_counted(module: Any) -> None:
    """Requests to cancel a task are counted and can be taken back, and none counts once it is done."""
    seen: list[int] = []

    async def work(count: Callable[[asyncio.Task[Any]], int]) -> None:
        task = asyncio.current_task()
        assert task is not None
        seen.append(count(task))
        for _ in range(2):
            try:
                await asyncio.Event().wait()
            except asyncio.CancelledError:
                seen.append(count(task))
                seen.append(module.uncancel(task))

    task = asyncio.create_task(work(module.cancelling))
    for _ in range(2):
        await asyncio.sleep(0)
        assert task.cancel()
    await task
    assert seen == [0, 1, 0, 1, 0]
    assert not task.cancel()
