"""A machine of a pool in a process of its own: ``python -m tests.networks.overlay.graph.pool_member BUNDLE ROUTER``."""

from __future__ import annotations

import asyncio
import sys
from collections.abc import Sequence

from ropeway.graph.base import Sample
from ropeway.graph.calls import Request
from ropeway.networks.overlay.crypto.identity import Identity
from ropeway.networks.overlay.graph import OverlayGraph
from ropeway.networks.overlay.node import OverlayNode
from tests.support.messages import STRING, sample
from tests.support.services import ADD, total


async def main(bundle: str, router: str) -> None:
    """Answer on ``/output`` what was said on ``/input``, and add, until stdin ends."""
    graph = OverlayGraph(OverlayNode(Identity.load(bundle), routers=[router], listen=()))
    await graph.open()
    output = await graph.create_publisher("/output", STRING)

    def arrived(batch: Sequence[Sample]) -> None:
        for one in batch:
            output.publish(sample(one.payload[8:-1].decode()))

    async def add(_: Request) -> bytes:
        return total(1)

    await graph.create_subscription("/input", STRING, None, arrived)
    await graph.create_service("/add", ADD, add)
    await asyncio.get_running_loop().run_in_executor(None, sys.stdin.read)
    await graph.close()


if __name__ == "__main__":
    asyncio.run(main(*sys.argv[1:]))
