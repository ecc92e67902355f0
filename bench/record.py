"""What recording costs: CPU at 30 MB/s, on a memory network in one process, beside the same without a recorder."""

from __future__ import annotations

import argparse
import asyncio
import tempfile
import time
from pathlib import Path
from typing import Final

from ropeway.graph.base import Sample, new_origin
from ropeway.networks.memory.graph import MemoryGraph
from ropeway.qos import QoS
from ropeway.recording.bag import Bag
from ropeway.recording.files import COMPRESSIONS, McapFiles
from ropeway.recording.graph_recorder import GraphRecorder, TopicChoice
from ropeway.recording.writer import RecordingWriter
from ropeway.types import TypeRegistry

IMAGE: Final = "sensor_msgs/msg/Image"
IMAGE_BYTES: Final = 305_000
IMAGES_HZ: Final = 100.0  # 30.5 MB/s
SMALL: Final = "geometry_msgs/msg/Twist"
SMALL_HZ: Final = 1_000.0


async def _publish(robot: MemoryGraph, seconds: float) -> int:
    """Publish images and small messages; return how many."""
    registry, origin = TypeRegistry(), new_origin()
    image = registry.codec(IMAGE).encode({"height": 1, "data": bytes(IMAGE_BYTES)})
    small = registry.codec(SMALL).encode({})
    images = await robot.create_publisher("/image", IMAGE, QoS(depth=100))
    smalls = await robot.create_publisher("/small", SMALL, QoS(depth=1_000))
    loop, count = asyncio.get_running_loop(), 0
    while not (images.subscribers and smalls.subscribers):
        await asyncio.sleep(0.01)
    begins = loop.time()
    for step in range(int(seconds * IMAGES_HZ)):
        await asyncio.sleep(max(0.0, begins + step / IMAGES_HZ - loop.time()))
        now_ns = time.time_ns()
        images.publish(Sample(image, IMAGE, now_ns, origin, step))
        for _ in range(int(SMALL_HZ / IMAGES_HZ)):
            smalls.publish(Sample(small, SMALL, now_ns, origin, step))
        count += 1 + int(SMALL_HZ / IMAGES_HZ)
    return count


async def _measure(compression: str | None, seconds: float, directory: Path) -> tuple[float, int, int]:
    """Return the CPU in parts of a core, the messages published, and those in the file."""
    robot, here = MemoryGraph("bench", node="/robot"), MemoryGraph("bench", node="/recorder")
    for graph in (robot, here):
        await graph.open()
    registry, path = TypeRegistry(), directory / f"{compression}.mcap"
    writer = RecordingWriter(McapFiles(path, compression=compression)) if compression else None
    sink = writer.put if writer is not None else (lambda message: None)
    recorder = GraphRecorder(here, registry, TopicChoice(everything=True), sink).start()
    before_s, began = time.process_time(), time.monotonic()
    count = await _publish(robot, seconds)
    if writer is not None:
        await writer.close()
    share = (time.process_time() - before_s) / (time.monotonic() - began)
    await recorder.close()
    for graph in (robot, here):
        await graph.close()
    recorded = 0
    if compression:
        with Bag(path, TypeRegistry()) as bag:
            recorded = sum(topic.count for topic in bag.topics)
        path.unlink()
    return share, count, recorded


async def main() -> None:
    """Print a line for each compression."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--seconds", type=float, default=5.0)
    seconds = parser.parse_args().seconds
    with tempfile.TemporaryDirectory() as directory:
        bare, _, _ = await _measure(None, seconds, Path(directory))
        print(f"without a recorder: {100 * bare:.1f} % of a core")
        for compression in COMPRESSIONS:
            share, sent, recorded = await _measure(compression, seconds, Path(directory))
            print(f"{compression:5}: {100 * (share - bare):+.1f} % of a core, {recorded} of {sent} messages recorded")


if __name__ == "__main__":
    asyncio.run(main())
