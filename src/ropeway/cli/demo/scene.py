"""Makes what the demo sends: a robot with a camera, an odometer and a driver, synthetic or from a recording."""

from __future__ import annotations

import asyncio
import math
import time
from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

from ropeway.extras import require
from ropeway.graph.base import SEQ_NONE, Graph, Sample, new_origin
from ropeway.qos import DEFAULT, SENSOR_DATA, QoS
from ropeway.types import TypeRegistry

if TYPE_CHECKING:
    from ropeway.recording.bag import BagTopic

__all__ = ["DemoTopic", "recorded_parts", "synthetic_parts"]

IMAGE: Final = "sensor_msgs/msg/Image"
ODOMETRY: Final = "nav_msgs/msg/Odometry"
COMMAND: Final = "geometry_msgs/msg/TwistStamped"
_CAMERAS: Final = (IMAGE, "sensor_msgs/msg/CompressedImage", "sensor_msgs/msg/PointCloud2", "sensor_msgs/msg/LaserScan")
_WIDTH: Final = 424
_HEIGHT: Final = 240

Sender = Callable[[Graph, Callable[[int], None]], Any]
"""Publishes on a graph until cancelled, and tells how many messages it has sent."""


@dataclass(frozen=True)
class DemoTopic:
    """A topic of the demo. ``side`` is where it is published: ``robot`` or ``cloud``."""

    topic: str
    type: str
    side: str
    send: Sender


def synthetic_parts(registry: TypeRegistry) -> list[DemoTopic]:
    """Make images both ways at 30 Hz, odometry at 50 Hz, commands at 20 Hz."""
    camera, annotated = _Picture(registry, seed=1), _Picture(registry, seed=2)
    return [
        DemoTopic("/camera/image", IMAGE, "robot", partial(_stream, "/camera/image", IMAGE, SENSOR_DATA, 30.0, camera)),
        odometry_part(registry),
        DemoTopic(
            "/annotated/image",
            IMAGE,
            "cloud",
            partial(_stream, "/annotated/image", IMAGE, SENSOR_DATA, 30.0, annotated),
        ),
        command_part(registry),
    ]


def odometry_part(registry: TypeRegistry) -> DemoTopic:
    """Make the odometry of a robot that drives in a circle."""
    codec = registry.codec(ODOMETRY)

    def make(number: int, now_ns: int) -> bytes:
        angle = number / 100
        pose = {"position": {"x": math.cos(angle), "y": math.sin(angle)}, "orientation": {"w": 1.0}}
        header = {"stamp": _stamp(now_ns), "frame_id": "odom"}
        return codec.encode({"header": header, "child_frame_id": "base_link", "pose": {"pose": pose}})

    return DemoTopic("/odom", ODOMETRY, "robot", partial(_stream, "/odom", ODOMETRY, DEFAULT, 50.0, make))


def command_part(registry: TypeRegistry) -> DemoTopic:
    """Make the commands of an operator in the cloud."""
    codec = registry.codec(COMMAND)

    def make(number: int, now_ns: int) -> bytes:
        twist = {"linear": {"x": 0.5}, "angular": {"z": math.sin(number / 20)}}
        return codec.encode({"header": {"stamp": _stamp(now_ns), "frame_id": "base_link"}, "twist": twist})

    return DemoTopic("/cmd_vel", COMMAND, "cloud", partial(_stream, "/cmd_vel", COMMAND, DEFAULT, 20.0, make))


def recorded_parts(registry: TypeRegistry, path: Path) -> list[DemoTopic]:
    """Return a recording's camera and odometry from the robot, its second camera (or the same) back from the cloud.

    What the recording lacks is made up. Raises ``BagUnreadable``.
    """
    require("bags", "ropeway demo --bag")
    from ropeway.recording.bag import Bag

    with Bag(path, registry) as bag:
        topics = [topic for topic in bag.topics if not topic.problem and topic.count]
    cameras = sorted(
        (topic for topic in topics if topic.type in _CAMERAS), key=lambda t: (_CAMERAS.index(t.type), -t.count)
    )
    odometry = next((topic for topic in topics if topic.type == ODOMETRY), None)
    made_up = synthetic_parts(registry)
    if not cameras:
        there = back = None
    else:
        there, back = cameras[0], cameras[1] if len(cameras) > 1 else cameras[0]
    parts = [_recorded(registry, path, there, "robot") if there else made_up[0]]
    parts.append(_recorded(registry, path, odometry, "robot") if odometry else made_up[1])
    if back:
        parts.append(_recorded(registry, path, back, "cloud", prefix="/annotated" if back is there else ""))
    else:
        parts.append(made_up[2])
    return [*parts, made_up[3]]


def _recorded(registry: TypeRegistry, path: Path, topic: BagTopic, side: str, prefix: str = "") -> DemoTopic:
    from ropeway.recording.bag import Bag
    from ropeway.recording.player import play

    async def send(graph: Graph, told: Callable[[int], None]) -> None:
        with Bag(path, registry) as bag:
            await play(
                graph,
                bag,
                topics=[topic.name],
                loop=True,
                restamp=True,
                rename=lambda name: prefix + name,
                told=lambda played: told(played.messages),
            )

    return DemoTopic(prefix + topic.name, topic.type, side, send)


async def _stream(
    topic: str,
    type: str,
    qos: QoS,
    rate_hz: float,
    make: Callable[[int, int], bytes],
    graph: Graph,
    told: Callable[[int], None],
) -> None:
    publisher = await graph.create_publisher(topic, type, qos)
    try:
        origin, number = new_origin(), 0
        loop = asyncio.get_running_loop()
        began = loop.time()
        while True:
            now_ns = time.time_ns()
            publisher.publish(Sample(make(number, now_ns), type, now_ns, origin, SEQ_NONE))
            number += 1
            told(number)
            await asyncio.sleep(max(began + number / rate_hz - loop.time(), 0))
    finally:
        await publisher.close()


def _stamp(now_ns: int) -> dict[str, int]:
    sec, nanosec = divmod(now_ns, 1_000_000_000)
    return {"sec": sec, "nanosec": nanosec}


class _Picture:
    """A camera that pans over a landscape of colours with the grain of a real sensor."""

    def __init__(self, registry: TypeRegistry, *, seed: int) -> None:
        import numpy as np

        random = np.random.default_rng(seed)
        x = np.linspace(0, 4 * np.pi, 4 * _WIDTH)
        y = np.linspace(0, 2 * np.pi, _HEIGHT)[:, None]
        waves = [np.sin(x * (band + 1) / 2 + seed) * np.cos(y + band) for band in range(3)]
        grain = random.normal(0, 2, (_HEIGHT, 4 * _WIDTH, 3))
        self._world = np.clip(np.stack(waves, axis=-1) * 90 + 128 + grain, 0, 255).astype(np.uint8)
        self._codec = registry.codec(IMAGE)

    def __call__(self, number: int, now_ns: int) -> bytes:
        left = 3 * _WIDTH * (1 - math.cos(number / 90)) / 2
        view = self._world[:, int(left) : int(left) + _WIDTH]
        return self._codec.encode(
            {
                "header": {"stamp": _stamp(now_ns), "frame_id": "camera"},
                "height": _HEIGHT,
                "width": _WIDTH,
                "encoding": "rgb8",
                "step": 3 * _WIDTH,
                "data": view.tobytes(),
            }
        )
