"""A server in a process of its own, for tests that mistreat it: prints its port, ends with its standard input."""

from __future__ import annotations

import asyncio
import logging
import sys

import uvloop

from ropeway import aio
from ropeway.hub.hub import Hub
from ropeway.listener.connection import Limits
from ropeway.networks.memory.graph import MemoryGraph
from ropeway.networks.rosbridge.server import RosbridgeServer
from ropeway.types import TypeRegistry


async def main() -> None:
    """Serve."""
    graph = MemoryGraph("served")
    await graph.open()
    limits = Limits(max_message_bytes=1 << 20, silence_s=30.0)  # hostile clients answer no pings
    server = RosbridgeServer(Hub(graph), TypeRegistry(), limits=limits, unregister_timeout_s=0.2)
    print((await server.listen("ws://127.0.0.1:0")).port, flush=True)
    await asyncio.to_thread(sys.stdin.read)
    await server.close()
    await graph.close()


if __name__ == "__main__":
    logging.basicConfig(level=logging.WARNING)
    with aio.Runner(loop_factory=uvloop.new_event_loop) as runner:
        runner.run(main())
