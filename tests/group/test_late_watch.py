"""ropeway.group.late_watch: what is late is noticed when it is, and not with the next request."""

from __future__ import annotations

import asyncio

import pytest

from ropeway.graph.calls import Request
from ropeway.group.bound import LatencyBound
from ropeway.group.late_watch import LateWatch
from tests.group.test_graph import Robot, robot
from tests.support.messages import sample
from tests.support.services import addends
from tests.support.until import until

__all__ = ["robot"]

pytestmark = pytest.mark.jumping

NEVER_S = 1e6


async def test_nothing_comes_any_more(robot: Robot) -> None:
    """Once a request is late, all that have no answer go to a second member, which is used from then on."""
    await robot.start({"edge1": 0.012, "edge2": 0.014}, stateless=True)
    await robot.ask(120)
    robot.group.scheduler.switch("edge1", robot.group.now())
    await asyncio.sleep(1.1)
    robot.machines["edge1"].latency_s = NEVER_S
    robot.heard.clear()
    loop = asyncio.get_running_loop()
    began_s = loop.time()
    for number in range(3):
        robot.input.publish(sample(f"late{number}"))
        await asyncio.sleep(0.011)
    await until(lambda: robot.group.scheduler.current == "edge2")
    assert loop.time() - began_s <= 0.05 + 0.005  # the bound
    await until(lambda: len(robot.heard) == 3)
    assert robot.heard == [f"late{number} by edge2" for number in range(3)]


async def test_calls(robot: Robot) -> None:
    """A call that is late has another member used by the next one, though nobody has called meanwhile."""
    await robot.start({"edge1": 0.012, "edge2": 0.014}, stateless=True)
    for _ in range(40):
        await robot.client.call(Request(addends(1)))
    robot.machines["edge1"].latency_s = NEVER_S
    calls = [asyncio.create_task(robot.client.call(Request(addends(1)))) for _ in range(2)]
    await asyncio.sleep(0.052)
    assert robot.group.scheduler.current == "edge2"
    await asyncio.gather(*calls)


async def test_without_a_bound(robot: Robot) -> None:
    """Without a bound nothing is late, and no timer runs."""
    group = await robot.start({"edge1": 0.012, "edge2": 0.014}, bound=LatencyBound())
    assert not LateWatch(group).idle


async def test_idle(robot: Robot) -> None:
    """After the last answer no timer runs, until something is sent again."""
    group = await robot.start({"edge1": 0.012, "edge2": 0.014})
    watch = LateWatch(group)
    assert watch.idle
    await robot.ask(1)
    watch.begin()
    assert not watch.idle
    await asyncio.sleep(1.0)
    assert watch.idle
    await robot.ask(1)
    watch.begin()
    watch.close()
    await asyncio.sleep(1.0)
    assert not watch.idle  # what is closed begins no more
