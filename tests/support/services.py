"""Services that add, and services that wait."""

from __future__ import annotations

import asyncio
import struct
from typing import Final

from ropeway.graph.calls import Request

__all__ = ["ADD", "TEXT", "Gate", "add", "addends", "answer", "total"]

ADD: Final = "example_interfaces/srv/AddTwoInts"
TEXT: Final = "diagnostic_msgs/srv/AddDiagnostics"


def addends(a: int, b: int = 0) -> bytes:
    """Return an AddTwoInts_Request as CDR."""
    return b"\0\1\0\0" + struct.pack("<qq", a, b)


def total(value: int) -> bytes:
    """Return an AddTwoInts_Response as CDR."""
    return b"\0\1\0\0" + struct.pack("<q", value)


def answer(value: str) -> bytes:
    """Return an AddDiagnostics_Response as CDR."""
    raw = value.encode() + b"\0"
    return b"\0\1\0\0\1\0\0\0" + struct.pack("<I", len(raw)) + raw


async def add(request: Request) -> bytes:
    """Add the two numbers."""
    return total(sum(struct.unpack("<qq", request.payload[4:20])))


class Gate:
    """A service that answers when told to."""

    def __init__(self) -> None:
        self.seen: list[Request] = []
        self.open = asyncio.Event()

    async def __call__(self, request: Request) -> bytes:
        self.seen.append(request)
        await self.open.wait()
        return await add(request)
