"""Services for the tests of the dds graph."""

from __future__ import annotations

import asyncio
import struct

from ropeway.graph.calls import Request
from ropeway.networks.dds import DdsGraph
from ropeway.networks.dds.client import DdsClient
from tests.support.services import ADD, addends, total
from tests.support.until import PATIENCE_S

TRIGGER = "std_srvs/srv/Trigger"


class Adder:
    """A handler that keeps what it was asked, and answers while ``open`` is set."""

    def __init__(self, *, open: bool = True) -> None:
        self.requests: list[Request] = []
        self.cancelled = 0
        self.open = asyncio.Event()
        if open:
            self.open.set()

    async def __call__(self, request: Request) -> bytes:
        self.requests.append(request)
        try:
            await self.open.wait()
        except asyncio.CancelledError:
            self.cancelled += 1
            raise
        a, b = struct.unpack("<qq", request.payload[4:])
        return total(a + b)


async def called(graph: DdsGraph, service: str, type: str = ADD) -> DdsClient:
    """A client whose server is matched."""
    client = await graph.create_client(service, type)
    assert await client.wait_available(PATIENCE_S)
    return client


async def add(client: DdsClient, a: int, b: int = 0, timeout_s: float = PATIENCE_S) -> int:
    """One call."""
    response = await client.call(Request(addends(a, b)), timeout_s)
    return int(struct.unpack("<q", response[4:])[0])


__all__ = ["TRIGGER", "Adder", "add", "called"]
