"""The three robots: each knows one way to be told where to go, and none of the others'."""

from __future__ import annotations

import asyncio
import json
import math
import os
import shutil
import subprocess
import time
from collections.abc import AsyncIterator, Sequence
from contextlib import asynccontextmanager
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Final

from ropeway import aio
from ropeway.errors import GraphUnavailable
from ropeway.graph.base import Graph, Sample
from ropeway.iort import AsyncNode, Value
from ropeway.qos import QoS
from ropeway.types import TypeRegistry

__all__ = ["SPEED_M_S", "TURN_RAD_S", "TWIST", "Alice", "Ros2Robot", "Track", "Walker", "ros1_missing", "ros1_robot"]

TWIST: Final = "geometry_msgs/msg/Twist"
SPEED_M_S: Final = 0.5
TURN_RAD_S: Final = 0.6
_STEP_S: Final = 0.02
_HOLD_S: Final = 0.5  # a robot that hears nothing for so long stops, as drivers of robots do
_PYTHON: Final = "/usr/bin/python3"  # Debian's, which has rospy

Track = list[tuple[float, float, float, float]]
"""Seconds, x and y in metres, heading in radians."""


@dataclass
class Walker:
    """Computes where a robot is from its speeds."""

    x: float = 0.0
    y: float = 0.0
    heading: float = 0.0
    speed: float = 0.0
    turn: float = 0.0
    until: float = math.inf  # when it stops by itself
    track: Track = field(default_factory=list)
    began: float = field(default_factory=time.monotonic)

    def command(self, speed: float, turn: float, hold_s: float = _HOLD_S) -> None:
        """Keep this speed, for ``hold_s`` at most."""
        self.speed, self.turn, self.until = speed, turn, time.monotonic() + hold_s

    async def walk(self) -> None:
        """Move until cancelled."""
        before = time.monotonic()
        while True:
            await asyncio.sleep(_STEP_S)
            now = time.monotonic()
            step = min(now, max(self.until, before)) - before
            self.heading += self.turn * step
            self.x += self.speed * step * math.cos(self.heading)
            self.y += self.speed * step * math.sin(self.heading)
            self.track.append((now - self.began, self.x, self.y, self.heading))
            before = now


class Ros2Robot(Walker):
    """Subscribes to ``/cmd_vel`` on a network of ROS 2."""

    async def join(self, graph: Graph, registry: TypeRegistry) -> None:
        """Start to listen for commands."""
        codec = registry.codec(TWIST)

        def heard(batch: Sequence[Sample]) -> None:
            message = codec.decode(bytes(batch[-1].payload))
            self.command(message["linear"]["x"], message["angular"]["z"])

        await graph.create_subscription("/cmd_vel", TWIST, QoS(depth=1), heard)


class Alice(Walker):
    """Knows codes to move (0 forward, 1 back, 4 stop) and angles to turn by, in degrees; nothing of ROS."""

    async def join(self, node: AsyncNode) -> None:
        """Start to listen for commands."""
        await node.subscribe("NAVI_ROBOT_MOVE_REQ", self._move)
        await node.subscribe("NAVI_GO_ROTATION_REQ", self._rotate)

    def _move(self, value: Value) -> None:
        speed = {"0": SPEED_M_S, "1": -SPEED_M_S}.get(value.text, 0.0)
        if speed or not self.turn or time.monotonic() > self.until:
            self.command(speed, 0.0, 5.0)

    def _rotate(self, value: Value) -> None:
        angle = math.radians(float(value.text))
        left = self.turn * max(self.until - time.monotonic(), 0.0) if self.turn else 0.0
        total = left + angle
        self.command(0.0, math.copysign(TURN_RAD_S, total), abs(total) / TURN_RAD_S)


def ros1_missing() -> str:
    """Return why ROS 1 cannot be used here, ``""`` if it can."""
    if shutil.which("roscore") is None:
        return "roscore is not installed (Debian: apt install python3-roslaunch python3-rospy ros-core)"
    done = subprocess.run(  # noqa: S603 - constant words
        [_PYTHON, "-c", "import rospy, geometry_msgs.msg"], capture_output=True, check=False, env=_environment(0)
    )
    return "" if done.returncode == 0 else "rospy is not installed (Debian: apt install python3-rospy)"


def _environment(port: int, home: Path | None = None) -> dict[str, str]:
    kept = {k: v for k, v in os.environ.items() if not k.startswith(("ROS_", "AMENT_", "PYTHON", "VIRTUAL_ENV"))}
    kept |= {"ROS_MASTER_URI": f"http://127.0.0.1:{port}", "ROS_HOSTNAME": "127.0.0.1"}
    return kept if home is None else {**kept, "ROS_HOME": str(home), "ROS_LOG_DIR": str(home)}


async def _listening(port: int) -> None:
    """Wait for the master; the robot's own waiting takes ten times as long."""
    for _ in range(200):
        try:
            _, writer = await asyncio.open_connection("127.0.0.1", port)
        except OSError:
            await asyncio.sleep(0.1)
        else:
            writer.close()
            return


async def _said_ready(lines: asyncio.StreamReader) -> None:
    line = b"\n"
    try:
        async with aio.timeout(30):
            while line not in (b"ready\n", b""):  # rospy has things to say, too
                line = await lines.readline()
    except TimeoutError:
        line = b""
    if not line:
        raise GraphUnavailable("ros1", "the robot of ROS 1 did not start; --no-ros1 leaves it out")


@asynccontextmanager
async def ros1_robot(directory: Path, port: int) -> AsyncIterator[Walker]:
    """Run a ROS 1 master and a rospy node that moves by ``/cmd_vel``; its track is there at the end."""
    environment = _environment(port, directory)
    program = Path(__file__).with_name("rospy_robot.py")
    walker = Walker()
    quiet = asyncio.subprocess.DEVNULL
    core = await asyncio.create_subprocess_exec(
        "roscore", "-p", str(port), stdout=quiet, stderr=quiet, env=environment, start_new_session=True
    )
    await _listening(port)
    robot = await asyncio.create_subprocess_exec(
        _PYTHON, str(program), stdout=asyncio.subprocess.PIPE, stderr=quiet, env=environment, limit=1 << 24
    )
    assert robot.stdout is not None
    try:
        await _said_ready(robot.stdout)
        walker.began = time.monotonic()
        yield walker
        robot.terminate()
        async with aio.timeout(10):
            line = await robot.stdout.readline()
            while not line.startswith(b"[["):
                line = await robot.stdout.readline()
        told: Any = json.loads(line)
        walker.track = [(t, x, y, heading) for t, x, y, heading in told]
    finally:
        for process in (robot, core):
            if process.returncode is None:
                process.terminate()
        for process in (robot, core):
            try:
                async with aio.timeout(10):
                    await process.wait()
            except TimeoutError:
                process.kill()
                await process.wait()
