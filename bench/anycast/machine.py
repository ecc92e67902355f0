"""A machine of the bench: a gateway, and a node that finds something in every frame and answers calls.

``python -m bench.anycast.machine NAME PORT CALLS``. What a frame takes stands in the frame, in seconds, so that the
latencies of all machines rise and fall together; a little noise of its own comes on top. Calls take what ``CALLS``
says: ``fixed:0.004``, or ``tail``, now and then much longer.
"""

from __future__ import annotations

import asyncio
import random
import sys
from collections.abc import Callable, Sequence
from typing import Final

from ropeway.gateway.config import config
from ropeway.gateway.gateway import Gateway
from ropeway.graph.base import Sample
from ropeway.graph.calls import Request
from ropeway.networks.memory.graph import MemoryGraph
from ropeway.types import TypeRegistry

FRAME: Final = "sensor_msgs/msg/CompressedImage"
FOUND: Final = "geometry_msgs/msg/PointStamped"
CALL: Final = "std_srvs/srv/Trigger"
NOISE_S: Final = 0.0005
TAIL_SHARE: Final = 0.03
TAIL_SHAPE: Final = 0.4
TAIL_BASE_S: Final = 0.05
LONGEST_S: Final = 4.0


def how_long(words: str, rng: random.Random) -> Callable[[], float]:
    """Return what says how long the next call takes."""
    kind, _, value = words.partition(":")
    if kind == "fixed":
        seconds = float(value)
        return lambda: seconds

    def tail() -> float:
        heavy = rng.random() < TAIL_SHARE
        factor = rng.paretovariate(TAIL_SHAPE) if heavy else rng.lognormvariate(0, 0.15)
        return min(LONGEST_S, TAIL_BASE_S * factor)

    return tail


async def serve(name: str, port: int, calls: str) -> None:
    """Answer until the process ends."""
    registry, rng = TypeRegistry(), random.Random()
    frames, found, answer = registry.codec(FRAME), registry.codec(FOUND), registry.codec(f"{CALL}_Response")
    graph = f"memory:{name}"
    settings = {"name": name, "graphs": [graph], "listen": [f"ws://0.0.0.0:{port}"], "insecure": True}
    async with Gateway(config.parse({"gateway": settings | {"control": False}, "remotes": []})):
        node = MemoryGraph(name, node=f"/{name}")
        await node.open()
        output = await node.create_publisher("/found", FOUND)
        took = how_long(calls, rng)
        loop = asyncio.get_running_loop()

        def say(header: dict[str, object], at: int) -> None:
            payload = found.encode({"header": header, "point": {"x": 0.0, "y": 0.0, "z": 0.0}})
            output.publish(Sample(payload, FOUND, at, name.encode().ljust(16, b"_")[:16], at))

        def look(batch: Sequence[Sample]) -> None:
            for sample in batch:
                message = frames.decode(sample.payload)
                seconds = float(message["format"]) + abs(rng.gauss(0, NOISE_S))
                stamp = message["header"]["stamp"]
                header = {"stamp": stamp, "frame_id": name}
                loop.call_later(seconds, say, header, stamp["sec"] * 1_000_000_000 + stamp["nanosec"])

        async def called(_: Request) -> bytes:
            await asyncio.sleep(took())
            return answer.encode({"success": True, "message": name})

        await node.create_subscription("/camera", FRAME, None, look)
        await node.create_service("/find", CALL, called)
        print("up", flush=True)
        await asyncio.Event().wait()


def main() -> None:
    """The command line."""
    name, port, calls = sys.argv[1:]
    asyncio.run(serve(name, int(port), calls))


if __name__ == "__main__":
    main()
