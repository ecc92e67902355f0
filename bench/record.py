"""What recording costs: CPU at 30 MB/s, on a memory network in one process, beside the same without a recorder."""

from __future__ import annotations

import argparse
import asyncio
import itertools
import random
import tempfile
import time
from pathlib import Path
from typing import Final, NamedTuple

from ropeway.graph.base import Sample, new_origin
from ropeway.networks.memory.graph import MemoryGraph
from ropeway.qos import QoS
from ropeway.recording.bag import Bag
from ropeway.recording.files import McapFiles
from ropeway.recording.graph_recorder import GraphRecorder, TopicChoice
from ropeway.recording.mcap_writer import COMPRESSIONS
from ropeway.recording.writer import RecordingWriter
from ropeway.types import TypeRegistry

IMAGE: Final = "sensor_msgs/msg/Image"
IMAGE_BYTES: Final = 305_000
BYTES_PER_S: Final = 30_500_000
MOST_READ: Final = 2_000  # messages of a recording: some seconds
SMALL: Final = "geometry_msgs/msg/Twist"
SMALL_HZ: Final = 1_000.0


class Payloads(NamedTuple):
    """Large messages of one type, published one after the other, at the rate that makes 30.5 MB/s of them."""

    type: str
    messages: list[bytes]

    @property
    def hz(self) -> float:
        return BYTES_PER_S / (sum(map(len, self.messages)) / len(self.messages))


def noise_payloads() -> Payloads:
    """Return an image of noise, which no compression makes smaller."""
    noise = random.Random(1).randbytes(IMAGE_BYTES)
    return Payloads(IMAGE, [TypeRegistry().codec(IMAGE).encode({"height": 1, "data": noise})])


def recorded_payloads(path: Path) -> Payloads:
    """Return messages of the topic of a recording that has the most bytes per message."""
    largest: dict[tuple[str, str], list[bytes]] = {}
    with Bag(path, TypeRegistry()) as bag:
        for record in itertools.islice(bag.records(), MOST_READ):
            largest.setdefault((record.topic.name, record.topic.type), []).append(record.payload)
    (name, type), messages = max(largest.items(), key=lambda item: sum(map(len, item[1])) / len(item[1]))
    print(f"{name} of {path.name}: {len(messages)} messages of {sum(map(len, messages)) / len(messages) / 1e3:.0f} kB")
    return Payloads(type, messages)


async def _publish(robot: MemoryGraph, seconds: float, payloads: Payloads) -> int:
    """Publish large and small messages; return how many."""
    origin = new_origin()
    small = TypeRegistry().codec(SMALL).encode({})
    images = await robot.create_publisher("/image", payloads.type, QoS(depth=100))
    smalls = await robot.create_publisher("/small", SMALL, QoS(depth=1_000))
    loop, count = asyncio.get_running_loop(), 0
    while not (images.subscribers and smalls.subscribers):
        await asyncio.sleep(0.01)
    begins = loop.time()
    hz, few = payloads.hz, 0.0
    for step in range(int(seconds * hz)):
        await asyncio.sleep(max(0.0, begins + step / hz - loop.time()))
        now_ns = time.time_ns()
        large = payloads.messages[step % len(payloads.messages)]
        images.publish(Sample(large, payloads.type, now_ns, origin, step))
        few += SMALL_HZ / hz
        for _ in range(int(few)):
            smalls.publish(Sample(small, SMALL, now_ns, origin, step))
        count += 1 + int(few)
        few %= 1
    return count


async def _measure(
    compression: str | None, seconds: float, directory: Path, payloads: Payloads
) -> tuple[float, int, int]:
    """Return the CPU in parts of a core, the messages published, and those in the file."""
    robot, here = MemoryGraph("bench", node="/robot"), MemoryGraph("bench", node="/recorder")
    for graph in (robot, here):
        await graph.open()
    registry, path = TypeRegistry(), directory / f"{compression}.mcap"
    writer = RecordingWriter(McapFiles(path, compression=compression)) if compression else None
    sink = writer.put if writer is not None else (lambda message: None)
    recorder = GraphRecorder(here, registry, TopicChoice(everything=True), sink).start()
    before_s, began = time.process_time(), time.monotonic()
    count = await _publish(robot, seconds, payloads)
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
    parser.add_argument("--bag", type=Path, help="publish messages of this recording in the place of noise")
    arguments = parser.parse_args()
    seconds = arguments.seconds
    payloads = recorded_payloads(arguments.bag) if arguments.bag else noise_payloads()
    with tempfile.TemporaryDirectory() as directory:
        bare, _, _ = await _measure(None, seconds, Path(directory), payloads)
        print(f"without a recorder: {100 * bare:.1f} % of a core")
        for compression in COMPRESSIONS:
            share, sent, recorded = await _measure(compression, seconds, Path(directory), payloads)
            print(f"{compression:5}: {100 * (share - bare):+.1f} % of a core, {recorded} of {sent} messages recorded")


if __name__ == "__main__":
    asyncio.run(main())
