"""What a verb says while it waits."""

from __future__ import annotations

import asyncio
from collections.abc import Callable

import pytest

from ropeway import aio
from ropeway.cli.patience import Patience, patiently, served_within, why_silent
from ropeway.cli.session import OpenGraph
from ropeway.graph.calls import Request
from ropeway.networks.memory.graph import MemoryGraph
from ropeway.qos import DEFAULT, LATCHED, SENSOR_DATA, QoS
from tests.support.messages import STRING
from tests.support.services import ADD, add, addends, total
from tests.support.until import PATIENCE_S, until

pytestmark = pytest.mark.jumping


async def said_until(said: Callable[[], str], text: str) -> str:
    """Everything that was said, once ``text`` is in it."""
    all_said = ""
    async with aio.timeout(PATIENCE_S):
        while text not in all_said:
            await asyncio.sleep(0.001)
            all_said += said()
    return all_said


async def test_waiting_is_told(capsys: pytest.CaptureFixture[str]) -> None:
    """What is waited for is said, and said again only when it is something else."""
    reasons = ["for a", "for a", "for b"]
    async with patiently(lambda: reasons.pop(0) if len(reasons) > 1 else reasons[0]):
        said = await said_until(lambda: capsys.readouterr().err, "for b")
    assert said == "for a\nfor b\n"


async def test_what_has_come_is_waited_for_no_longer(capsys: pytest.CaptureFixture[str]) -> None:
    """Once it has come, nothing is said."""
    waiting = Patience(lambda: "for a")
    waiting.over()
    await waiting.watch()
    assert capsys.readouterr().err == ""


async def test_why_nothing_comes(pair: tuple[OpenGraph, OpenGraph]) -> None:
    """The graph tells that nobody publishes, or publishes another type or with other QoS, or sends nothing."""
    here, there = pair
    await there.graph.create_publisher("/odom", STRING, SENSOR_DATA)

    def why(topic: str, type: str = STRING, qos: QoS | None = None) -> str:
        return why_silent(here.graph, topic, type, qos).removeprefix(f"waiting for a message on {topic}: ")

    assert why("/odomm") == f'nobody publishes it on {here.graph.name}; did you mean "/odom"?'
    assert why("/camera") == f"nobody publishes it on {here.graph.name}"
    assert why("/odom", "std_msgs/msg/Int8") == f"it is published as {STRING}, and std_msgs/msg/Int8 was asked for"
    assert why("/odom", qos=DEFAULT).startswith("its publishers offer incompatible QoS (RELIABILITY)")
    assert why("/odom", qos=LATCHED).startswith("its publishers offer incompatible QoS (DURABILITY, RELIABILITY)")
    assert why("/odom") == f"1 publisher on {here.graph.name}, none of which has sent anything"
    await there.graph.create_publisher("/odom", STRING, DEFAULT)
    assert why("/odom", qos=DEFAULT) == f"2 publishers on {here.graph.name}, none of which has sent anything"


async def test_a_server_that_comes_late_is_waited_for() -> None:
    """A call waits for its server within its time, and has the rest of it; with nobody there it has next to none."""
    near, far = MemoryGraph("late", node="/near"), MemoryGraph("late", node="/far")
    await near.open()
    await far.open()
    client = await near.create_client("/sum", ADD)
    waiting = asyncio.create_task(served_within(client, 60))
    await until(lambda: not waiting.done() and bool(near.network.clients))
    await far.create_service("/sum", ADD, add)
    left_s = await waiting
    assert 0 < left_s <= 60
    assert await client.call(Request(addends(1, 2)), left_s) == total(3)
    nobody = await near.create_client("/nobody", ADD)
    assert await served_within(nobody, 0.05) == 0.001
    await near.close()
    await far.close()
