"""A gateway in a process of its own that tells, for each line it is sent, what it holds.

Started with a configuration as its argument; prints a line of JSON with its ports, then one for each line of its
standard input, and ends with that.
"""

from __future__ import annotations

import asyncio
import gc
import json
import logging
import sys
import threading
from collections import Counter
from typing import Any

import psutil
import uvloop

from ropeway import aio
from ropeway.gateway.config import config
from ropeway.gateway.gateway import Gateway


def held(gateway: Gateway) -> dict[str, Any]:
    """What is there now, once everything is gone that nobody refers to."""
    gc.collect()
    process = psutil.Process()
    kinds = Counter(
        type(each).__qualname__ for each in gc.get_objects() if str(type(each).__module__).startswith("ropeway")
    )
    return {
        "rss_bytes": process.memory_info().rss,
        "descriptors": process.num_fds(),
        "threads": threading.active_count(),
        "tasks": len(asyncio.all_tasks()),
        "sessions": sum(len(server.sessions) for server in gateway.servers),
        "objects": dict(kinds),
    }


async def main() -> None:
    """Serve."""
    async with Gateway(config.parse(json.loads(sys.argv[1]))) as gateway:
        status = gateway.status()
        listening = [*status["listen"], *status.get("nodes", {}).get("listen", ())]
        print(json.dumps([listener["port"] for listener in listening]), flush=True)
        while await asyncio.to_thread(sys.stdin.readline):
            print(json.dumps(held(gateway)), flush=True)


if __name__ == "__main__":
    logging.basicConfig(level=logging.ERROR)
    with aio.Runner(loop_factory=uvloop.new_event_loop) as runner:
        runner.run(main())
