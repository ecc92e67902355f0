"""Print the messages of a topic, without ROS: python examples/echo.py /chatter [dds:0]."""

import asyncio
import sys

import ropeway


async def main(topic: str = "/chatter", url: str = "dds:0") -> None:
    """Print each message until Ctrl-C; the type is that of the topic's publisher, who is waited for."""
    async with ropeway.open(url) as graph, graph.subscribe(topic, timeout_s=None) as messages:
        print(f"reading {topic}, a {messages.type}", flush=True)
        async for message in messages:
            print(message.to_json(), flush=True)


asyncio.run(main(*sys.argv[1:]))
