"""How many requests may be at a server."""

from __future__ import annotations

import asyncio

import pytest

from ropeway.networks.dds.in_flight import InFlightRequests
from ropeway.tasks import end
from tests.support.clock import Stopwatch

pytestmark = pytest.mark.jumping


async def entered(window: InFlightRequests, count: int) -> tuple[list[int], list[asyncio.Task[int]]]:
    """Tickets of those who are in, and tasks of those who wait."""
    tasks = [asyncio.create_task(window.enter()) for _ in range(count)]
    await asyncio.sleep(0)
    await asyncio.sleep(0)
    return [task.result() for task in tasks if task.done()], [task for task in tasks if not task.done()]


async def test_half_of_what_is_kept() -> None:
    """Half of what the server keeps may be under way; each answer lets in the next."""
    window = InFlightRequests()
    window.resize(8)
    tickets, waiting = await entered(window, 10)
    assert len(tickets) == 4
    window.leave(tickets[0], answered=True)
    await asyncio.wait(waiting, timeout=1, return_when=asyncio.FIRST_COMPLETED)
    assert [task.done() for task in waiting] == [True] + [False] * 5
    window.resize(1000)
    await asyncio.gather(*waiting)
    window.close()


async def test_unknown_depth() -> None:
    """A server that does not tell is taken to keep ten, one that keeps few gets one at a time."""
    window = InFlightRequests()
    window.resize(0)
    assert len((await entered(window, 5))[0]) == 5
    window = InFlightRequests()
    window.resize(1)
    tickets, waiting = await entered(window, 2)
    assert len(tickets) == 1
    await end(*waiting)
    window.close()


async def test_cancelled() -> None:
    """Who stops waiting takes no place, also when let in at the same moment."""
    window = InFlightRequests()
    window.resize(2)
    (ticket,), waiting = await entered(window, 4)
    await end(waiting[0])
    window.leave(ticket, answered=True)
    waiting[1].cancel()
    await asyncio.wait(waiting[1:])
    assert waiting[1].cancelled()
    assert waiting[2].result()
    window.close()


async def test_patience() -> None:
    """Where nothing is answered for a second, one more is let out."""
    watch = Stopwatch()
    window = InFlightRequests()
    window.resize(2)
    tickets, waiting = await entered(window, 3)
    done, _ = await asyncio.wait(waiting, timeout=5, return_when=asyncio.FIRST_COMPLETED)
    assert done == {waiting[0]}
    assert watch.seconds == 1
    window.leave(tickets[0], answered=False)
    window.close()
    await asyncio.gather(*waiting)


async def test_deferred() -> None:
    """A service that answers later by design gets all of a burst, in parts."""
    window = InFlightRequests(deferred=True)
    window.resize(10)
    tickets, waiting = await entered(window, 20)
    assert len(tickets) == 5
    await asyncio.wait_for(asyncio.gather(*waiting), 5)
    window.close()


async def test_closed() -> None:
    """Closing lets everybody go."""
    window = InFlightRequests()
    _, waiting = await entered(window, 20)
    window.close()
    await asyncio.wait_for(asyncio.gather(*waiting), 5)
