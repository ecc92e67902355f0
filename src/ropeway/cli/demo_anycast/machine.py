"""A machine of the demo, as a process: a gateway, and a node that answers every frame.

``python -m ropeway.cli.demo_anycast.machine NAME PORT``; it prints a line once it listens.
"""

from __future__ import annotations

import asyncio
import sys
from collections.abc import Sequence
from typing import Final

from ropeway.gateway.config import config
from ropeway.gateway.gateway import Gateway
from ropeway.graph.base import Sample, new_origin
from ropeway.networks.memory.graph import MemoryGraph
from ropeway.types import TypeRegistry

__all__ = ["ANSWER", "FRAME"]

FRAME: Final = "sensor_msgs/msg/CompressedImage"
ANSWER: Final = "geometry_msgs/msg/PointStamped"
WORK_S: Final = 0.005


async def serve(name: str, port: int) -> None:
    """Answer until the process ends."""
    registry = TypeRegistry()
    frames, answers, origin = registry.codec(FRAME), registry.codec(ANSWER), new_origin()
    settings = {"name": name, "graphs": [f"memory:{name}"], "listen": [f"ws://127.0.0.1:{port}"], "control": False}
    async with Gateway(config.parse({"gateway": settings})):
        node = MemoryGraph(name, node="/detector")
        await node.open()
        output = await node.create_publisher("/found", ANSWER)
        loop = asyncio.get_running_loop()

        def say(stamp: dict[str, int]) -> None:
            number = stamp["sec"] * 1_000_000_000 + stamp["nanosec"]
            payload = answers.encode({"header": {"stamp": stamp, "frame_id": name}})
            output.publish(Sample(payload, ANSWER, number, origin, number))

        def look(batch: Sequence[Sample]) -> None:
            for sample in batch:
                loop.call_later(WORK_S, say, frames.decode(sample.payload)["header"]["stamp"])

        await node.create_subscription("/camera", FRAME, None, look)
        print("up", flush=True)
        await asyncio.Event().wait()


if __name__ == "__main__":
    asyncio.run(serve(sys.argv[1], int(sys.argv[2])))
