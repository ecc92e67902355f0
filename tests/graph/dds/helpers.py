"""Messages and waiting for the tests of the dds graph."""

from __future__ import annotations

import asyncio
import struct
import subprocess
import sys
import textwrap
import time
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path

from ropeway.graph.base import SEQ_NONE, Sample

STRING = "std_msgs/msg/String"
DDS_STRING = "std_msgs::msg::dds_::String_"


def text(value: str) -> bytes:
    """A std_msgs/msg/String as CDR."""
    raw = value.encode() + b"\0"
    return b"\0\1\0\0" + struct.pack("<I", len(raw)) + raw


def message(value: str, seq: int = SEQ_NONE) -> Sample:
    """A sample with a std_msgs/msg/String."""
    return Sample(text(value), STRING, time.time_ns(), bytes(16), seq)


class Inbox:
    """A callback that keeps what arrives."""

    def __init__(self) -> None:
        self.samples: list[Sample] = []
        self.batches = 0
        self._arrived = asyncio.Event()

    def __call__(self, batch: Sequence[Sample]) -> None:
        self.samples.extend(batch)
        self.batches += 1
        self._arrived.set()

    @property
    def payloads(self) -> list[bytes]:
        return [s.payload for s in self.samples]

    async def wait(self, count: int, timeout_s: float = 10.0) -> list[Sample]:
        async with asyncio.timeout(timeout_s):
            while len(self.samples) < count:
                self._arrived.clear()
                await self._arrived.wait()
        return self.samples


@contextmanager
def process(code: str, *arguments: object) -> Iterator[subprocess.Popen[str]]:
    """Python code in a process of its own, with ``helpers`` imported; ``sys.argv[1:]`` are the arguments."""
    prelude = (
        "import asyncio, sys, time\nfrom tests.support.until import until\nfrom tests.graph.dds.helpers import *\n"
    )
    prelude += "from ropeway.graph.dds import DdsGraph\nfrom ropeway.qos import *\n"
    with subprocess.Popen(
        [sys.executable, "-c", prelude + textwrap.dedent(code), *map(str, arguments)],
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        text=True,
        cwd=Path(__file__).parents[3],
    ) as child:
        try:
            yield child
        finally:
            child.kill()
