"""Programs that use a client library, and what they say."""

from __future__ import annotations

import asyncio
import contextlib
import json
from asyncio.subprocess import PIPE, Process
from collections.abc import AsyncIterator, Callable
from contextlib import asynccontextmanager
from typing import Any

from ropeway import aio
from tests.support.until import PATIENCE_S

__all__ = ["Peers", "peers"]


class Peers:
    """The clients of one program."""

    def __init__(self, process: Process) -> None:
        self._process = process
        self.said: list[dict[str, Any]] = []
        self._news = asyncio.Event()
        self._reading = asyncio.create_task(self._read())

    async def _read(self) -> None:
        assert self._process.stdout is not None
        async for line in self._process.stdout:
            if line.startswith(b"{"):
                self.said.append(json.loads(line))
                self._news.set()

    async def wait(self, condition: Callable[[], object], timeout_s: float = PATIENCE_S) -> None:
        """Wait until something holds of what was said."""
        async with aio.timeout(timeout_s):
            while not condition():
                self._news.clear()
                await self._news.wait()

    async def connected(self, count: int = 1) -> None:
        """Wait until so many clients are connected."""

        def there() -> set[int]:
            return {s["client"] for s in self.said if "connected" in s}

        try:
            await self.wait(lambda: len(there()) >= count)
        except TimeoutError:
            ended = self._process.returncode
            raise AssertionError(f"of {count} clients {sorted(there())} are connected; exit status {ended}") from None

    def publish(self) -> None:
        """Let every client publish once."""
        assert self._process.stdin is not None
        self._process.stdin.write(b"\n")

    def do(self, **command: Any) -> None:
        """Let the clients do something, or the one that it names as ``client``."""
        assert self._process.stdin is not None
        self._process.stdin.write(json.dumps(command).encode() + b"\n")

    async def told(self, count: int = 1, **what: Any) -> list[dict[str, Any]]:
        """Wait until so many lines say this, and give them all."""

        def found() -> list[dict[str, Any]]:
            return [s for s in self.said if all(s.get(key) == value for key, value in what.items())]

        await self.wait(lambda: len(found()) >= count)
        return found()

    def heard(self, topic: str, client: int | None = None) -> list[Any]:
        """The messages that the clients, or one of them, got of a topic."""
        return [
            s["message"] for s in self.said if s.get("topic") == topic and (client is None or s["client"] == client)
        ]

    async def end(self) -> None:
        """End the program."""
        assert self._process.stdin is not None
        self._process.stdin.close()
        try:
            async with aio.timeout(5):
                await self._process.wait()
        except TimeoutError:
            with contextlib.suppress(ProcessLookupError):
                self._process.kill()
            await self._process.wait()
        await self._reading


@asynccontextmanager
async def peers(*command: str, plan: dict[str, Any]) -> AsyncIterator[Peers]:
    """Run a program with its plan as the last word; it is ended at the end of the block."""
    process = await asyncio.create_subprocess_exec(*command, json.dumps(plan), stdin=PIPE, stdout=PIPE, limit=1 << 24)
    program = Peers(process)
    try:
        yield program
    finally:
        await program.end()
