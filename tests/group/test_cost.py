"""The price of a group: calls of Python that it adds to a message and to a call, whatever the machine."""

from __future__ import annotations

import asyncio
import sys
from collections.abc import Awaitable, Callable
from pathlib import Path
from types import FrameType
from typing import Any, Final

import pytest

import ropeway.group
from ropeway.graph.calls import Request
from ropeway.group.bound import LatencyBound
from ropeway.group.graph import Policy
from tests.group.test_graph import Robot, robot
from tests.support.messages import sample
from tests.support.services import addends

pytestmark = pytest.mark.jumping

__all__ = ["robot"]

FOUR: Final = {"edge1": 0.001, "edge2": 0.002, "cloud1": 0.003, "cloud2": 0.004}
BOUND: Final = LatencyBound.of({"p99": 0.5})
ROOM: Final = str(Path(ropeway.group.__file__).parent)
SAMPLES: Final = 20
MESSAGE_CALLS: Final = 3
"""Calls for a message: to publish, and to ask who gets it."""
ANSWERED_CALLS: Final = 18
"""Calls for a message that is answered on another topic: the request is noted, and the answer paired with it."""
SERVICE_CALLS: Final = 10
"""Calls for a service call: who is asked, and what its latency is."""
HEDGED_CALLS: Final = 34
"""Calls for one whose next member is asked, too, if the first is late."""


async def fewest(one: Callable[[], Awaitable[Any]]) -> list[str]:
    """Return the fewest calls within the room of groups while ``one`` runs: now and then something is judged."""
    found: list[list[str]] = []

    def profile(frame: FrameType, event: str, _: object) -> None:
        code = frame.f_code
        if event == "call" and code.co_filename.startswith(ROOM):
            found[-1].append(code.co_name)

    for _ in range(SAMPLES):
        found.append([])
        sys.setprofile(profile)
        try:
            await one()
        finally:
            sys.setprofile(None)
        await asyncio.sleep(0.02)
    return min(found, key=len)


async def test_a_message(robot: Robot) -> None:
    """A message of a topic that nobody answers costs a look at who is in use, whatever the number of members."""
    await robot.start(FOUR, bound=BOUND, exchanges={})
    await robot.ask(60)

    async def one() -> None:
        robot.input.publish(sample("one"))

    assert len(calls := await fewest(one)) <= MESSAGE_CALLS, calls


async def test_an_answered_message(robot: Robot) -> None:
    """A message that is answered on another topic costs little more."""
    await robot.start(FOUR, bound=BOUND)
    await robot.ask(60)

    async def one() -> None:
        heard = len(robot.heard)
        robot.input.publish(sample("one"))
        while len(robot.heard) == heard:
            await asyncio.sleep(0.001)

    assert len(calls := await fewest(one)) <= ANSWERED_CALLS, " ".join(calls)


@pytest.mark.parametrize(
    ("options", "most"),
    [
        ({}, SERVICE_CALLS),
        ({"bound": LatencyBound()}, SERVICE_CALLS),
        ({"stateless": True}, HEDGED_CALLS),
        ({"policy": Policy.HEDGE, "stateless": True}, HEDGED_CALLS),
    ],
    ids=["one", "without a bound", "stateless", "hedge"],
)
async def test_a_call(robot: Robot, options: dict[str, Any], most: int) -> None:
    """A call is passed on in the task of its caller, with few calls of our own."""
    await robot.start(FOUR, **({"bound": BOUND, "exchanges": {}} | options))
    for _ in range(200):
        await robot.client.call(Request(addends(1)))
    tasks: list[str] = []
    loop = asyncio.get_running_loop()

    def factory(loop: asyncio.AbstractEventLoop, work: Any, **given: Any) -> asyncio.Task[Any]:
        tasks.append(getattr(work, "__qualname__", ""))
        return asyncio.Task(work, loop=loop, **given)

    loop.set_task_factory(factory)
    calls = await fewest(lambda: robot.client.call(Request(addends(1))))
    assert len(calls) <= most, calls
    assert not [name for name in tasks if "ask_one" in name], "a task of its own for a call"
