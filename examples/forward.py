"""Forward one topic to another network, as it is: python examples/forward.py /odom dds:0 ws://cloud.example:9090."""

import asyncio
import sys

import ropeway


async def main(topic: str, source_url: str, target_url: str) -> None:
    """Pass each message on without decoding it; a bridge (bridge.py) also follows QoS, and forwards on demand."""
    async with (
        ropeway.open(source_url) as source,
        ropeway.open(target_url) as target,
        source.subscribe(topic, timeout_s=30) as messages,
        target.publisher(topic, messages.type, qos=messages.qos) as publisher,
    ):
        print(f"forwarding {topic}", flush=True)
        async for message in messages:
            publisher.publish(message)


asyncio.run(main(*sys.argv[1:4]))
