"""A gateway in a process of its own that tells, for each line it is sent, what it holds.

Started with a configuration as its argument, of a gateway or (``{"router": {"identity": FILE, "listen": ENDPOINT}}``)
of a router; prints a line of JSON with its ports, then one for each line of its standard input, and ends with that.
"""

from __future__ import annotations

import asyncio
import gc
import json
import logging
import resource
import sys
import threading
from collections import Counter
from contextlib import AsyncExitStack
from pathlib import Path
from typing import Any, Final

import psutil
import uvloop

from ropeway import aio
from ropeway.gateway.config import config
from ropeway.gateway.gateway import Gateway
from ropeway.networks.overlay.crypto.identity import Identity
from ropeway.networks.overlay.router import Router
from ropeway.networks.rosbridge.server.server import RosbridgeServer

_MORE_BYTES: Final = 512 << 20  # of addresses than at the start: whoever makes it reserve more makes it fail


def held(servers: list[RosbridgeServer]) -> dict[str, Any]:
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
        "sessions": sum(len(server.sessions) for server in servers),
        "objects": dict(kinds),
    }


async def serve(document: dict[str, Any], stack: AsyncExitStack) -> tuple[list[int], list[RosbridgeServer]]:
    """Start what is measured; return its ports, and the servers that have sessions."""
    if "router" in document:
        identity, endpoint = document["router"]["identity"], document["router"]["listen"]
        await stack.enter_async_context(Router(Identity.load(Path(identity)), listen=[endpoint]))
        return [int(endpoint.rpartition(":")[2])], []
    gateway = await stack.enter_async_context(Gateway(config.parse(document)))
    status = gateway.status()
    listening = [*status["listen"], *status.get("nodes", {}).get("listen", ())]
    return [listener["port"] for listener in listening], gateway.servers


def limit_memory() -> None:
    """Let the process have little more memory than it has now."""
    most = psutil.Process().memory_info().vms + _MORE_BYTES
    resource.setrlimit(resource.RLIMIT_AS, (most, most))


async def main() -> None:
    """Serve."""
    async with AsyncExitStack() as stack:
        ports, servers = await serve(json.loads(sys.argv[1]), stack)
        limit_memory()
        print(json.dumps(ports), flush=True)
        while await asyncio.to_thread(sys.stdin.readline):
            print(json.dumps(held(servers)), flush=True)


if __name__ == "__main__":
    logging.basicConfig(level=logging.ERROR)
    with aio.Runner(loop_factory=uvloop.new_event_loop) as runner:
        runner.run(main())
