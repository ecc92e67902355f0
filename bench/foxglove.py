"""Viewers of a robot: what does one cost the gateway? And one that stands still?

A camera at 60 Hz and twenty small topics at 50 Hz are watched by viewers over the Foxglove WebSocket protocol.
``--peer`` measures another server in the same run, whose command has ``{port}`` for the port to listen on, such as
``--peer "ros2 run foxglove_bridge foxglove_bridge --ros-args -p port:={port}"`` in a sourced ROS 2. The two take turns,
so that what else runs on the machine disturbs both alike; the processor time of a message counts where a busy machine
does not let the robot keep its rates.
"""

from __future__ import annotations

import argparse
import asyncio
import json
import shlex
import statistics
import struct
import tempfile
import time
from pathlib import Path
from typing import Any

import psutil
import uvloop

from bench.netns import Process
from bench.paper import config
from bench.report import table
from ropeway import aio
from ropeway.errors import ConnectFailed
from ropeway.graph.base import SEQ_NONE, Sample
from ropeway.listener.connection import Connection, Limits
from ropeway.listener.subprotocols import FOXGLOVE_SUBPROTOCOLS
from ropeway.listener.websocket import connect
from ropeway.networks.dds.graph import DdsGraph
from ropeway.qos import QoS
from ropeway.types import TypeRegistry

PORT, DOMAIN = 19310, 69
CAMERA_HZ, SMALL_HZ, SMALL = 60, 50, 20
IMAGE, IMU = "sensor_msgs/msg/Image", "sensor_msgs/msg/Imu"


async def publish(seconds: float) -> None:
    """Be the robot."""
    registry = TypeRegistry()
    graph = DdsGraph(DOMAIN, interface="lo", registry=registry)
    await graph.open()
    camera = await graph.create_publisher("/camera", IMAGE, QoS(depth=5))
    small = [await graph.create_publisher(f"/imu{number}", IMU, QoS()) for number in range(SMALL)]
    image = registry.codec(IMAGE).encode({"height": 480, "width": 640, "step": 1920, "data": bytes(640 * 480 * 3)})
    imu = registry.codec(IMU).encode({})
    began = time.monotonic()
    ticks = {CAMERA_HZ: 0, SMALL_HZ: 0}
    while (now := time.monotonic() - began) < seconds:
        if now * CAMERA_HZ >= ticks[CAMERA_HZ]:
            ticks[CAMERA_HZ] += 1
            camera.publish(Sample(image, IMAGE, time.time_ns(), bytes(16), SEQ_NONE))
        if now * SMALL_HZ >= ticks[SMALL_HZ]:
            ticks[SMALL_HZ] += 1
            for publisher in small:
                publisher.publish(Sample(imu, IMU, time.time_ns(), bytes(16), SEQ_NONE))
        due = min(ticks[hz] / hz for hz in ticks)
        await asyncio.sleep(max(due - (time.monotonic() - began), 0))
    await graph.close()


class Watcher:
    """A viewer that reads every channel of the robot, and counts the messages of its own ids by size."""

    def __init__(self) -> None:
        self.images = self.small = self.subscribed = 0
        self.connection: Connection

    async def join(self) -> None:
        """Connect, and wait until all topics are read."""
        for _ in range(200):
            try:
                self.connection = await connect(
                    f"ws://127.0.0.1:{PORT}",
                    limits=Limits(ping_interval_s=None),
                    subprotocols=FOXGLOVE_SUBPROTOCOLS,
                    on_connection=self._connected,
                )
                break
            except ConnectFailed:
                await asyncio.sleep(0.1)
        async with aio.timeout(60):
            while self.subscribed < SMALL + 1:
                await asyncio.sleep(0.05)

    def _connected(self, connection: Connection) -> None:
        self.connection = connection
        connection.on_text, connection.on_binary = self._told, self._got

    def _told(self, data: bytes) -> None:
        told = json.loads(data)
        if told["op"] != "advertise":
            return
        wanted = [c["id"] for c in told["channels"] if c["topic"].startswith(("/camera", "/imu"))]
        self.subscribed += len(wanted)
        pairs = [{"id": number, "channelId": number} for number in wanted]
        self.connection.send_text(json.dumps({"op": "subscribe", "subscriptions": pairs}))

    def _got(self, data: bytes | memoryview) -> None:
        if struct.unpack_from("<B", data)[0] != 1:
            return
        if len(data) > 100_000:
            self.images += 1
        else:
            self.small += 1


def used_s(process: Process) -> float:
    """Return the processor time of a program and all that it started."""
    first = psutil.Process(process.pid)
    times = [one.cpu_times() for one in (first, *first.children(recursive=True))]
    return sum(time.user + time.system for time in times)


def start(directory: str, peer: str) -> Process:
    """Start the server that is measured."""
    if peer:
        program, *rest = shlex.split(peer.format(port=PORT))
        return Process(None, *rest, program=program, ROS_DOMAIN_ID=str(DOMAIN))
    listen = f"foxglove://127.0.0.1:{PORT}"
    path = config(Path(directory), "viewed", [], listen, f"dds:{DOMAIN}?interface=lo")
    return Process(None, "-m", "ropeway", "run", path, "--quiet")


async def cost(peer: str, viewers: int, seconds: float) -> tuple[float, float, float]:
    """Return the share of a core that the server takes, and the images and small messages per second and viewer."""
    with tempfile.TemporaryDirectory() as directory:
        robot = Process(None, "-m", "bench.foxglove", "--robot", str(seconds + 30))
        server = start(directory, peer)
        try:
            watchers = [Watcher() for _ in range(viewers)]
            for watcher in watchers:
                await watcher.join()
            await asyncio.sleep(1.5)
            first, began = used_s(server), time.monotonic()
            counts = [(watcher.images, watcher.small) for watcher in watchers]
            await asyncio.sleep(seconds)
            span = time.monotonic() - began
            share = (used_s(server) - first) / span
            images = sum(w.images - c[0] for w, c in zip(watchers, counts, strict=True))
            small = sum(w.small - c[1] for w, c in zip(watchers, counts, strict=True))
        finally:
            server.stop()
            robot.stop()
    return 100 * share, images / max(viewers, 1) / span, small / max(viewers, 1) / span


async def stalled(seconds: float) -> tuple[float, float, float]:
    """Return the memory before and after a viewer stands still, and the images of another one per second meanwhile."""
    with tempfile.TemporaryDirectory() as directory:
        robot = Process(None, "-m", "bench.foxglove", "--robot", str(seconds + 40))
        server = start(directory, "")
        try:
            good, bad = Watcher(), Watcher()
            await good.join()
            await bad.join()
            bad.connection.pause_reading()
            await asyncio.sleep(2)
            before, images, began = server.memory_bytes(), good.images, time.monotonic()
            await asyncio.sleep(seconds)
            rate = (good.images - images) / (time.monotonic() - began)
            after = server.memory_bytes()
        finally:
            server.stop()
            robot.stop()
    return before / 1e6, after / 1e6, rate


def main() -> None:
    """Take the command line."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--seconds", type=float, default=6)
    parser.add_argument("--viewers", type=int, nargs="*", default=[1, 3], help="how many watch, one table row for each")
    parser.add_argument("--rounds", type=int, default=1, help="the table has the medians of so many")
    parser.add_argument(
        "--stall", type=float, default=8, help="seconds; a viewer that reads nothing for 10 s is closed"
    )
    parser.add_argument("--peer", default="", help="the command of another server, measured beside")
    parser.add_argument("--robot", type=float, default=0, help=argparse.SUPPRESS)
    parser.add_argument("--json", action="store_true")
    args = parser.parse_args()
    with aio.Runner(loop_factory=uvloop.new_event_loop) as runner:
        if args.robot:
            runner.run(publish(args.robot))
            return
        rows: list[list[Any]] = []
        peers = ["", *([args.peer] if args.peer else [])]
        for count in args.viewers:
            found: dict[str, list[tuple[float, float, float]]] = {peer: [] for peer in peers}
            for _ in range(args.rounds):
                for peer in peers:
                    found[peer].append(runner.run(cost(peer, count, args.seconds)))
            for peer, figures in found.items():
                share, images, small = (statistics.median(each) for each in zip(*figures, strict=True))
                per_message_us = 1e4 * statistics.median(f[0] / max(f[1] + f[2], 1e-9) for f in figures) / count
                name = Path(shlex.split(peer)[0]).name if peer else "ropeway"
                rows.append([name, count, share, share / count, images, small, per_message_us])
        heads = ["server", "viewers", "% of a core", "each", "images/s", "small/s", "µs/message"]
        table("Viewers of a camera (921 kB) at 60 Hz and 20 topics at 50 Hz", heads, rows, as_json=args.json)
        before, after, rate = runner.run(stalled(args.stall))
        stalls = [[before, after, rate]]
        heads = ["MB before", "MB after", "images/s of another"]
        table("One of two viewers stands still", heads, stalls, as_json=args.json)


if __name__ == "__main__":
    main()
