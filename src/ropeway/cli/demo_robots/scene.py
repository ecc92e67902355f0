"""Plays the demo: five robots with gateways, a cloud, and a reader of its transforms that comes late."""

from __future__ import annotations

import asyncio
import math
from collections.abc import Callable, Sequence
from contextlib import AsyncExitStack
from dataclasses import dataclass, field
from typing import Any, Final

from ropeway import aio
from ropeway.gateway.config import config
from ropeway.gateway.gateway import Gateway
from ropeway.graph.base import SEQ_NONE, Publisher, Sample, new_origin
from ropeway.networks.memory.graph import MemoryGraph
from ropeway.qos import LATCHED, QoS
from ropeway.types import TypeRegistry

__all__ = ["ROBOTS", "Picture", "Pose", "play"]

TF: Final = "tf2_msgs/msg/TFMessage"
ROBOTS: Final = tuple(f"robot{number}" for number in range(1, 6))
RATE_HZ: Final = 20.0
START_S: Final = 30.0
CAMERA_AHEAD_M: Final = 0.3

Pose = tuple[float, float, float]
"""Where a robot is on the map, in metres, and where it looks, in radians."""


@dataclass
class Picture:
    """Holds poses of robots over time, and the frames that are mounted on each with how far ahead."""

    tracks: dict[str, list[Pose]] = field(default_factory=lambda: {name: [] for name in ROBOTS})
    mounted: dict[str, dict[str, float]] = field(default_factory=lambda: {name: {} for name in ROBOTS})

    def moved(self, message: dict[str, Any]) -> None:
        """Take a message of ``/tf``: where each robot's ``base_link`` is."""
        for transform in message["transforms"]:
            robot, _, frame = transform["child_frame_id"].partition("/")
            if robot in self.tracks and frame == "base_link":
                at, turned = transform["transform"]["translation"], transform["transform"]["rotation"]
                self.tracks[robot].append((at["x"], at["y"], 2 * math.atan2(turned["z"], turned["w"])))

    def holds(self, message: dict[str, Any]) -> None:
        """Take a message of ``/tf_static``: what is mounted on a robot."""
        for transform in message["transforms"]:
            robot, _, frame = transform["child_frame_id"].partition("/")
            if robot in self.mounted and transform["header"]["frame_id"] == f"{robot}/base_link":
                self.mounted[robot][frame] = transform["transform"]["translation"]["x"]


def _transform(parent: str, child: str, pose: Pose) -> dict[str, Any]:
    x, y, heading = pose
    rotation = {"z": math.sin(heading / 2), "w": math.cos(heading / 2)}
    return {
        "header": {"frame_id": parent},
        "child_frame_id": child,
        "transform": {"translation": {"x": x, "y": y}, "rotation": rotation},
    }


def pose_of(number: int, at_s: float) -> Pose:
    """Return where a robot is that drives in a circle of its own, each a little faster than the one before."""
    angle = (0.5 + 0.15 * number) * at_s + number
    radius = 0.8
    column, row = number % 3, number // 3
    return 2.2 * column + radius * math.cos(angle), 2.2 * row + radius * math.sin(angle), angle + math.pi / 2


async def play(seconds: float, *, say: Callable[[str], None]) -> Picture:
    """Drive for so long; return what one reader in the cloud has seen."""
    picture, codec = Picture(), TypeRegistry().codec(TF)
    async with AsyncExitStack() as stack:
        say("starting five robots that call their frames alike, and a cloud")
        cloud = await _gateway(stack, "cloud", "ws://127.0.0.1:0", [])
        address = f"ws://127.0.0.1:{cloud.servers[0].listeners[0].port}"
        robots = [await _robot(stack, name, address) for name in ROBOTS]
        origin = new_origin()

        def sample(*transforms: dict[str, Any]) -> Sample:
            return Sample(codec.encode({"transforms": transforms}), TF, 0, origin, SEQ_NONE)

        for _, static in robots:
            static.publish(sample(_transform("base_link", "camera", (CAMERA_AHEAD_M, 0.0, 0.0))))
        reader = MemoryGraph("demo-robots-cloud", node="/viewer")
        await reader.open()
        stack.push_async_callback(reader.close)
        complete = asyncio.Event()

        def moved(batch: Sequence[Sample]) -> None:
            for one in batch:
                picture.moved(codec.decode(one.payload))

        def mounted(batch: Sequence[Sample]) -> None:
            for one in batch:
                picture.holds(codec.decode(one.payload))
            if all(picture.mounted.values()):
                complete.set()

        await reader.create_subscription("/tf_static", TF, LATCHED, mounted)
        await reader.create_subscription("/tf", TF, QoS(depth=100), moved)
        async with aio.timeout(START_S):
            await complete.wait()
        say(f"all are there; they drive for {seconds:g} s")
        loop = asyncio.get_running_loop()
        begins = loop.time()
        for step in range(int(seconds * RATE_HZ)):
            await asyncio.sleep(max(0.0, begins + step / RATE_HZ - loop.time()))
            for number, (moving, _) in enumerate(robots):
                at = _transform("map", "base_link", pose_of(number, step / RATE_HZ))
                moving.publish(sample(at))
        await asyncio.sleep(1 / RATE_HZ)
    return picture


async def _gateway(stack: AsyncExitStack, name: str, listen: str, remotes: list[dict[str, Any]]) -> Gateway:
    settings = {
        "name": name,
        "graphs": [f"memory:demo-robots-{name}"],
        "listen": [listen] if listen else [],
        "control": {"enabled": False},
    }
    return await stack.enter_async_context(Gateway(config.parse({"gateway": settings, "remotes": remotes})))


async def _robot(stack: AsyncExitStack, name: str, cloud: str) -> tuple[Publisher, Publisher]:
    """Start a robot with its gateway; return its publishers of ``/tf`` and ``/tf_static``."""
    items = [{"name": topic, "type": TF, "frame_prefix": f"{name}/"} for topic in ("/tf", "/tf_static")]
    await _gateway(stack, name, "", [{"address": cloud, "publish": items}])
    node = MemoryGraph(f"demo-robots-{name}", node="/driver")
    await node.open()
    stack.push_async_callback(node.close)
    return await node.create_publisher("/tf", TF, QoS(depth=100)), await node.create_publisher(
        "/tf_static", TF, LATCHED
    )
