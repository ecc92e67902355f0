"""The clocks of tests: the loop that jumps, and the time a thread was held up."""

from __future__ import annotations

import asyncio
import time

import pytest

from ropeway import aio
from tests.support.clock import Stopwatch, held_up, queued_s


@pytest.mark.jumping
async def test_jumps() -> None:
    """Sleeping takes as long as it should on the loop, and next to no time in truth."""
    watch, began = Stopwatch(), time.process_time()
    await asyncio.gather(asyncio.sleep(3600), asyncio.sleep(7200))
    assert watch.seconds == 7200
    with pytest.raises(TimeoutError):
        async with aio.timeout(60):
            await asyncio.Event().wait()
    assert watch.seconds == 7260
    assert time.process_time() - began < 1


@pytest.mark.jumping
async def test_waits_for_sockets_and_threads() -> None:
    """While something is on its way to a socket of this process or done in a thread, the time stands still."""

    async def echo(reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        writer.write(await reader.readline())
        writer.close()

    watch = Stopwatch()
    async with await asyncio.start_server(echo, "127.0.0.1", 0) as server, aio.timeout(1):
        reader, writer = await asyncio.open_connection(*server.sockets[0].getsockname())
        writer.write(b"x" * 60_000 + b"\n")
        assert len(await reader.readline()) == 60_001
        writer.close()
        await asyncio.to_thread(time.sleep, 0.1)
        assert watch.seconds == 0


def test_held_up() -> None:
    """What waits is held up; what works is not, however many others want the processor."""
    with held_up() as seconds:
        time.sleep(0.1)
    assert seconds() > 0.09
    with held_up() as seconds:
        sum(range(1_000_000))
    assert seconds() < 0.05
    assert queued_s() >= 0
