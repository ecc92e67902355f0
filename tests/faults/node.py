"""A gateway with a robot beside it in one process, for tests of faults between machines.

The only argument is a JSON object: ``name``, ``graph`` (of memory unless told), ``listen`` (URLs), ``remotes`` as in a
configuration, ``publish`` (topic to rate in Hz) and ``read`` (topics) of the robot, ``ahead_s`` by which the clock is
wrong, ``size`` of the messages; ``serve`` makes the robot serve ``/slow`` (a service that never answers) and ``/move``
(an action that ends when it is cancelled), ``use`` makes it call the one and send a goal to the other, over and over.
Prints what happens as JSON lines: ``{"t": <time.monotonic()>, "queued": <seconds without a processor>, ...}``.
"""

from __future__ import annotations

import asyncio
import contextlib
import json
import logging
import sys
import time
from collections.abc import Sequence
from typing import Any

import uvloop

order: dict[str, Any] = json.loads(sys.argv[1])
if order.get("ahead_s"):
    _true_time_ns, _true_time = time.time_ns, time.time
    time.time_ns = lambda: _true_time_ns() + int(order["ahead_s"] * 1e9)
    time.time = lambda: _true_time() + order["ahead_s"]

from ropeway import aio  # noqa: E402
from ropeway.errors import CallError, GraphUnavailable  # noqa: E402
from ropeway.gateway.config import config  # noqa: E402  # with the clock as it is to be
from ropeway.gateway.gateway import Gateway  # noqa: E402
from ropeway.graph.base import SEQ_NONE, Graph, Sample  # noqa: E402
from ropeway.graph.calls import ActionHandlers, Goal, GoalStatus, Outcome, Request, ServerGoal  # noqa: E402
from ropeway.networks.factory import open_graph  # noqa: E402
from ropeway.networks.rosbridge.client import RosbridgeGraph  # noqa: E402
from ropeway.qos import QoS  # noqa: E402
from tests.faults.node_types import ACTION, SERVICE  # noqa: E402
from tests.support.clock import queued_s  # noqa: E402
from tests.support.messages import STRING, text  # noqa: E402


def tell(**event: Any) -> None:
    print(json.dumps({"t": time.monotonic(), "queued": queued_s(), **event}), flush=True)


async def talk(robot: Graph, topic: str, hz: float) -> None:
    """Publish numbers."""
    publisher = await robot.create_publisher(topic, STRING, QoS(depth=10))
    padding = "x" * order.get("size", 0)
    number, began = 0, time.monotonic()
    while True:
        number += 1
        publisher.publish(Sample(text(f"{number} {padding}"), STRING, time.time_ns(), bytes(16), SEQ_NONE))
        await asyncio.sleep(began + number / hz - time.monotonic())


def hears(topic: str) -> Any:
    def heard(batch: Sequence[Sample]) -> None:
        for sample in batch:
            tell(topic=topic, n=int(bytes(sample.payload[8:28]).split(b" ")[0]), origin=sample.origin.hex())

    return heard


async def serve(robot: Graph) -> None:
    """Serve what takes its time, and tell how it goes."""

    async def slow(request: Request) -> bytes:
        tell(call="began")
        await asyncio.Event().wait()
        return b""

    async def move(goal: ServerGoal) -> Outcome:
        tell(goal="began")
        try:
            await goal.cancelled.wait()
        finally:
            tell(goal="cancelled")
        return Outcome(GoalStatus.CANCELED, b"\0\1\0\0\0\0\0\0")

    await robot.create_service("/slow", SERVICE, slow)
    await robot.create_action_server("/move", ACTION, ActionHandlers(move))


async def call(robot: Graph) -> None:
    """Call, and tell how it ends."""
    client = await robot.create_client("/slow", SERVICE)
    while True:
        if await client.wait_available(1):
            try:
                await client.call(Request(b"\0\1\0\0"), 60)
            except (CallError, GraphUnavailable) as error:
                tell(failed=type(error).__name__, text=str(error))


async def send(robot: Graph) -> None:
    """Send goals, and tell how they end."""
    client = await robot.create_action_client("/move", ACTION)
    while True:
        if await client.wait_available(1):
            try:
                goal = await client.send_goal(Goal(b"\0\1\0\0\3\0\0\0"))
                outcome = await goal.result()
                tell(ended=outcome.status.name, text=outcome.text)
            except (CallError, GraphUnavailable) as error:
                tell(rejected=str(error))


async def main() -> None:
    """Run until standard input ends."""
    name = order["name"]
    graph = order.get("graph", f"memory:{name}")
    settings = {"name": name, "graphs": [graph], "listen": order.get("listen", []), "insecure": True}
    settings |= order.get("settings", {})
    robot = await open_graph(graph, name="robot")
    ends = asyncio.ensure_future(asyncio.to_thread(sys.stdin.readline))
    async with Gateway(config.parse({"gateway": settings, "remotes": order.get("remotes", [])})) as gateway:
        ports = [listener.port for server in gateway.servers for listener in server.listeners]
        for topic in order.get("read", ()):
            await robot.create_subscription(topic, STRING, QoS(depth=100), hears(topic))
        talking = [asyncio.create_task(talk(robot, t, hz)) for t, hz in order.get("publish", {}).items()]
        if order.get("serve"):
            await serve(robot)
        if order.get("use"):
            talking += [asyncio.create_task(call(robot)), asyncio.create_task(send(robot))]
        for remote in gateway.remotes:
            if isinstance(remote.graph, RosbridgeGraph):
                remote.graph.on_state(lambda state: tell(state=state.value))
        tell(ready=ports)
        sessions, told = 0, 0.0
        while not ends.done():
            count = sum(len(server.sessions) for server in gateway.servers)
            if count != sessions:
                tell(sessions=count)
                sessions = count
            if time.monotonic() - told > 0.5:
                told = time.monotonic()
                tell(status=gateway.status())
            await asyncio.wait([ends], timeout=0.02)
        for task in talking:
            task.cancel()
            with contextlib.suppress(asyncio.CancelledError):
                await task
    await robot.close()


if __name__ == "__main__":
    logging.basicConfig(level=logging.WARNING)
    with aio.Runner(loop_factory=uvloop.new_event_loop) as runner:
        runner.run(main())
