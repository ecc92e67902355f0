"""ropeway.processor_queue: a process that the machine lets wait is not taken for one that hangs."""

from __future__ import annotations

import asyncio
import os
import subprocess
import sys
from collections.abc import Iterator

import pytest

from ropeway import processor_queue
from ropeway.processor_queue import ProcessorQueue, patience, queued_s
from tests.support.clock import Stopwatch
from tests.support.until import until

BUSY = "import os\nos.sched_setaffinity(0, {min(os.sched_getaffinity(0))})\nwhile True:\n    pass"


@pytest.fixture
def busy() -> Iterator[list[int]]:
    """Two processes that want the same processor all the time."""
    processes = [subprocess.Popen([sys.executable, "-c", BUSY]) for _ in range(2)]
    yield [process.pid for process in processes]
    for process in processes:
        process.kill()
        process.wait()


@pytest.mark.skipif(not sys.platform.startswith("linux"), reason="needs Linux, which counts it")
async def test_two_on_one_processor(busy: list[int]) -> None:
    """Of two processes that want the same processor, each waits for it."""
    for queue in [ProcessorQueue(lambda pid=pid: pid) for pid in busy]:
        await until(queue.lap)


def test_laps(monkeypatch: pytest.MonkeyPatch) -> None:
    """A lap has what was added since the one before; of a process that took the place of another it has all."""
    waited_s = {1: 5.0, 2: 3.0}
    monkeypatch.setattr(processor_queue, "queued_s", lambda pid: waited_s.get(pid, 0.0))
    pid: int | None = 1
    queue = ProcessorQueue(lambda: pid)
    assert queue.lap() == 0.0
    waited_s[1] = 7.0
    assert (queue.lap(), queue.lap()) == (2.0, 0.0)
    pid = 2
    assert (queue.lap(), queue.lap()) == (3.0, 0.0)
    pid = None
    assert queue.lap() == 0.0


def test_no_process() -> None:
    """A process that is not there has waited for nothing."""
    gone = subprocess.Popen([sys.executable, "-c", ""])
    gone.wait()
    assert queued_s(gone.pid) == queued_s(None) == 0.0
    assert queued_s(os.getpid()) >= 0.0


@pytest.mark.jumping
async def test_a_process_that_hangs(monkeypatch: pytest.MonkeyPatch) -> None:
    """Where the process waited for no processor, the time is over when it is over."""
    monkeypatch.setattr(processor_queue, "queued_s", lambda _: 4.0)
    watch = Stopwatch()
    with pytest.raises(TimeoutError):
        async with patience(10.0, lambda: 1):
            await asyncio.sleep(100)
    assert watch.seconds == 10.0


@pytest.mark.jumping
async def test_a_process_that_is_let_wait(monkeypatch: pytest.MonkeyPatch) -> None:
    """Time in which the process waited for a processor is added, as long as more of it comes."""
    loop = asyncio.get_running_loop()
    monkeypatch.setattr(processor_queue, "queued_s", lambda _: min(loop.time(), 30.0))  # it ran never, and then hung
    watch = Stopwatch()
    with pytest.raises(TimeoutError):
        async with patience(10.0, lambda: 1):
            await asyncio.sleep(100)
    assert watch.seconds == 40.0
    async with patience(10.0, lambda: 1):
        await asyncio.sleep(5)
    assert watch.seconds == 45.0


@pytest.mark.jumping
async def test_what_goes_wrong_inside() -> None:
    """An error of the block is its own, and so is a cancellation from outside."""
    with pytest.raises(KeyError):
        async with patience(10.0, lambda: None):
            raise KeyError("inside")

    async def wait() -> None:
        async with patience(10.0, lambda: None):
            await asyncio.sleep(100)

    task = asyncio.create_task(wait())
    await asyncio.sleep(1)
    task.cancel()
    with pytest.raises(asyncio.CancelledError):
        await task
