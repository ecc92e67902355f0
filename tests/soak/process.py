"""The test's side of a gateway in a process of its own."""

from __future__ import annotations

import asyncio
import json
import sys
from asyncio.subprocess import PIPE, Process
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager
from pathlib import Path
from typing import Any, NamedTuple, cast

__all__ = ["Held", "Served", "serving"]

PROGRAM = Path(__file__).with_name("gateway.py")
LINE_BYTES = 1 << 20


class Held(NamedTuple):
    """What the process holds."""

    rss_bytes: int
    descriptors: int
    threads: int
    tasks: int
    sessions: int
    objects: dict[str, int]

    def grown(self, before: Held) -> dict[str, int]:
        """Which classes have more objects than before."""
        more = {kind: count - before.objects.get(kind, 0) for kind, count in self.objects.items()}
        return {kind: count for kind, count in more.items() if count > 0}


class Served:
    """A gateway that runs. ``ports`` are those of its listeners, in the order of the configuration."""

    def __init__(self, process: Process, ports: list[int]) -> None:
        self.process, self.ports = process, ports

    async def held(self) -> Held:
        assert self.process.stdin is not None
        self.process.stdin.write(b"\n")
        return Held(**await self._line())

    async def settled(self, before: Held | None = None, timeout_s: float = 60.0) -> Held:
        """What it holds once nobody is there any more, and (within reason) as few as before."""
        async with asyncio.timeout(timeout_s):
            while True:
                found = await self.held()
                calm = not found.sessions and (before is None or found.tasks <= before.tasks)
                if calm and (before is None or found.descriptors <= before.descriptors):
                    return found
                await asyncio.sleep(0.2)

    async def _line(self) -> Any:
        assert self.process.stdout is not None
        line = await self.process.stdout.readline()
        assert line, "the gateway has ended"
        return json.loads(line)


@asynccontextmanager
async def serving(config: dict[str, Any]) -> AsyncIterator[Served]:
    """A gateway with this configuration."""
    process = await asyncio.create_subprocess_exec(
        sys.executable, str(PROGRAM), json.dumps(config), stdin=PIPE, stdout=PIPE, limit=LINE_BYTES
    )
    try:
        served = Served(process, [])
        served.ports = cast("list[int]", await served._line())
        yield served
    finally:
        assert process.stdin is not None
        process.stdin.close()
        await process.wait()
