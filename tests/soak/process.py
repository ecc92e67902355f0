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

import psutil

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

    def grown(self, before: Held, at_most: int) -> dict[str, int]:
        """Of what there is more than before, by more than ``at_most``: classes, and what the process holds."""
        more = {kind: count - before.objects.get(kind, 0) for kind, count in self.objects.items()}
        found = {kind: count for kind, count in more.items() if count > at_most}
        for what in ("descriptors", "threads", "tasks", "sessions"):
            if getattr(self, what) > getattr(before, what):
                found[what] = getattr(self, what) - getattr(before, what)
        return found


class Served:
    """A gateway that runs. ``ports`` are those of its listeners, in the order of the configuration."""

    def __init__(self, process: Process, ports: list[int]) -> None:
        self.process, self.ports = process, ports

    async def held(self) -> Held:
        assert self.process.stdin is not None
        self.process.stdin.write(b"\n")
        return Held(**await self._line())

    async def settled(self, before: Held | None = None, at_most: int = 0, timeout_s: float = 30.0) -> Held:
        """What it holds once nobody is there any more, and nothing that was not before; or after so long."""
        loop = asyncio.get_running_loop()
        until = loop.time() + timeout_s
        while True:
            found = await self.held()
            calm = not found.sessions if before is None else not found.grown(before, at_most)
            if calm or loop.time() > until:
                return found
            await asyncio.sleep(0.2)

    def forget_peak(self) -> None:
        """Begin to look anew for the most that is resident."""
        Path(f"/proc/{self.process.pid}/clear_refs").write_text("5")

    def peak_bytes(self) -> int:
        """Return the most that was resident, as the kernel counted it."""
        status = Path(f"/proc/{self.process.pid}/status").read_text()
        return next(int(line.split()[1]) << 10 for line in status.splitlines() if line.startswith("VmHWM:"))

    def busy_s(self) -> float:
        """Return how long it has computed."""
        return sum(psutil.Process(self.process.pid).cpu_times()[:2])

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
