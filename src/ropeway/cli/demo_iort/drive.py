"""Brings the robots and the gateways up, and drives."""

from __future__ import annotations

import asyncio
import math
import sys
import time
from collections.abc import AsyncIterator, Callable
from contextlib import AsyncExitStack, asynccontextmanager
from pathlib import Path
from typing import Any, Final

from ropeway import aio
from ropeway.cli.demo.gateways import free_port
from ropeway.cli.demo_iort.robots import SPEED_M_S, TURN_RAD_S, TWIST, Alice, Ros2Robot, Track, Walker, ros1_robot
from ropeway.errors import GraphUnavailable
from ropeway.gateway.config.config import parse
from ropeway.gateway.gateway import Gateway
from ropeway.iort import AsyncNode
from ropeway.networks import open_graph
from ropeway.tasks import end
from ropeway.types import TypeRegistry

__all__ = ["SCRIPT", "drive"]

SCRIPT: Final = (
    ("forward 2 s", SPEED_M_S, 0.0, 2.0),
    ("turn about 45 degrees", 0.0, TURN_RAD_S, math.radians(45) / TURN_RAD_S),
    ("forward 1 s", SPEED_M_S, 0.0, 1.0),
    ("turn about 180 degrees", 0.0, TURN_RAD_S, math.radians(180) / TURN_RAD_S),
)
"""The IoRT paper's second test (section 5.2): what is said, metres and radians per second, seconds."""

_RATE_HZ: Final = 10.0
_READY_S: Final = 20.0
_CODES: Final = {"0": {"linear.x": SPEED_M_S}, "1": {"linear.x": -SPEED_M_S}, "4": {}}
_KEYS: Final = {
    "w": (1, 0),
    "s": (-1, 0),
    "a": (0, 1),
    "d": (0, -1),
    "A": (1, 0),
    "B": (-1, 0),
    "D": (0, 1),
    "C": (0, -1),  # how the sequences of the arrow keys end
}


def _maps() -> list[dict[str, Any]]:
    """Return the maps: one ROS name, /cmd_vel, for what the driver publishes and each robot reads in its own way."""
    common = {"name": "/cmd_vel", "type": TWIST}
    alice = {**common, "system": "ALICE", "direction": "out"}
    return [
        {**common, "system": "PC", "topic": "cmd_vel", "form": "floats", "direction": "in"},
        {**alice, "topic": "NAVI_ROBOT_MOVE_REQ", "form": "codes", "codes": _CODES},
        {**alice, "topic": "NAVI_GO_ROTATION_REQ", "form": "angle", "rate_rad_s": TURN_RAD_S},
    ]


async def drive(
    directory: Path, domain: int, *, with_ros1: bool, keyboard: bool, say: Callable[[str], None]
) -> dict[str, Track]:
    """Drive the robots and return their tracks, by name."""
    registry = TypeRegistry()
    port = free_port()
    url = f"iort://127.0.0.1:{port}"
    network = f"dds:{domain}?interface=127.0.0.1"
    walkers: dict[str, Walker] = {}
    async with AsyncExitStack() as stack:
        gateway = {
            "name": "station",
            "graphs": [network],
            "listen": [url],
            "iort": {"maps": _maps()},
            "store": {"path": str(directory / "values.sqlite")},
        }
        say("a gateway on ROS 2 that serves nodes")
        station = await stack.enter_async_context(Gateway(parse({"gateway": gateway}), registry=registry))
        if with_ros1:
            say("a master of ROS 1, a robot of rospy, and a gateway between it and the nodes")
            master = free_port()
            walkers["ROS 1"] = await stack.enter_async_context(ros1_robot(directory, master))
            remote = {
                "address": url,
                "maps": [{"system": "PC", "topic": "cmd_vel", "type": TWIST, "form": "floats", "name": "/cmd_vel"}],
                "subscribe": [{"name": "/cmd_vel", "type": TWIST}],
            }
            graphs = [f"ros1:http://127.0.0.1:{master}"]
            second = {"gateway": {"name": "ros1_side", "graphs": graphs, "listen": []}, "remotes": [remote]}
            await stack.enter_async_context(Gateway(parse(second), registry=registry))
        graph = await open_graph(network, registry=registry, name="turtlebot4")
        stack.push_async_callback(graph.close)
        ros2 = walkers["ROS 2"] = Ros2Robot()
        await ros2.join(graph, registry)
        alice = walkers["Alice"] = Alice()
        body = await stack.enter_async_context(_connected("ALICE", url))
        await alice.join(body)
        walking = [asyncio.create_task(w.walk()) for name, w in walkers.items() if name != "ROS 1"]
        stack.push_async_callback(end, *walking)
        driver = await stack.enter_async_context(_connected("PC", url))
        await _ready(station, with_ros1)
        say("all are there")
        await (_by_keys(driver, say) if keyboard else _by_script(driver, say))
        await asyncio.sleep(1.0)  # what still rolls comes to rest
    order = [name for name in ("ROS 2", "ROS 1", "Alice") if name in walkers]
    return {name: walkers[name].track for name in order}


@asynccontextmanager
async def _connected(name: str, url: str) -> AsyncIterator[AsyncNode]:
    node = AsyncNode(name, url)
    await node.open(5.0)
    try:
        yield node
    finally:
        await node.close()


async def _ready(station: Gateway, with_ros1: bool) -> None:
    """Wait until the driver's commands have a way to every robot."""
    assert station.nodes is not None
    nodes = station.nodes
    began = time.monotonic()
    while True:
        subscribed = {(e.node, e.system) for _, e in nodes.space.endpoints() if e.kind == "subscription"}
        there = [("ALICE", "ALICE")] + ([("ros1_side", "PC")] if with_ros1 else [])
        active = all(bridge.state == "active" for bridge in nodes.bridges.values())
        if active and subscribed.issuperset(there):
            return
        if time.monotonic() - began > _READY_S:
            raise GraphUnavailable("demo", f"the robots did not find the gateway within {_READY_S:g} s")
        await asyncio.sleep(0.05)


async def _by_script(driver: AsyncNode, say: Callable[[str], None]) -> None:
    for text, speed, turn, seconds in SCRIPT:
        say(text)
        loop = asyncio.get_running_loop()
        began = loop.time()
        while (left := began + seconds - loop.time()) > 0:
            driver.publish_nowait("cmd_vel", [speed, 0, 0, 0, 0, turn])
            await asyncio.sleep(min(1 / _RATE_HZ, left))
        await driver.publish("cmd_vel", [0, 0, 0, 0, 0, 0])
        await asyncio.sleep(0.3)


async def _by_keys(driver: AsyncNode, say: Callable[[str], None]) -> None:
    """Drive by arrow keys or WASD until q."""
    import termios
    import tty

    terminal = sys.stdin.fileno()
    before = termios.tcgetattr(terminal)
    loop = asyncio.get_running_loop()
    keys: asyncio.Queue[str] = asyncio.Queue()

    def pressed() -> None:
        for key in sys.stdin.read(1):
            keys.put_nowait(key)

    tty.setcbreak(terminal)
    loop.add_reader(terminal, pressed)
    say("w a s d or the arrow keys; q ends")
    try:
        moving = False
        while True:
            try:
                async with aio.timeout(0.3):
                    key = await keys.get()
            except TimeoutError:
                if moving:
                    await driver.publish("cmd_vel", [0, 0, 0, 0, 0, 0])
                    moving = False
                continue
            if key == "q":
                return
            if key in _KEYS:
                forward, left = _KEYS[key]
                moving = True
                driver.publish_nowait("cmd_vel", [forward * SPEED_M_S, 0, 0, 0, 0, left * TURN_RAD_S])
    finally:
        loop.remove_reader(terminal)
        termios.tcsetattr(terminal, termios.TCSADRAIN, before)
