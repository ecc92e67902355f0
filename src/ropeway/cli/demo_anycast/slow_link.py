"""A link with a delay that can be changed while it runs: what comes in on a port goes on to another, later."""

from __future__ import annotations

import asyncio
import contextlib
from typing import Final

from ropeway.tasks import background, end

__all__ = ["SlowLink"]

_CHUNK_BYTES: Final = 64 << 10
_WAITING: Final = 256  # chunks on the way; a sender that is faster waits


class SlowLink:
    """Passes TCP connections on to ``port``, each way ``delay_s`` late."""

    def __init__(self, port: int, delay_s: float) -> None:
        self.delay_s = delay_s
        self.port = 0
        self._to = port
        self._server: asyncio.Server | None = None
        self._open: set[asyncio.Task[None]] = set()

    async def start(self) -> None:
        """Listen on a free port of this machine."""
        self._server = await asyncio.start_server(self._accepted, "127.0.0.1", 0)
        self.port = self._server.sockets[0].getsockname()[1]

    async def close(self) -> None:
        """End it, and all connections."""
        if self._server is not None:
            self._server.close()
        await end(*self._open)

    async def _accepted(self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        task = asyncio.current_task()
        assert task is not None
        self._open.add(task)
        try:
            there_reader, there_writer = await asyncio.open_connection("127.0.0.1", self._to)
            await asyncio.gather(self._pass(reader, there_writer), self._pass(there_reader, writer))
        except (OSError, asyncio.IncompleteReadError):
            return  # one side is gone, so the other is told below
        finally:
            self._open.discard(task)
            writer.close()

    async def _pass(self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        """Pass one direction on until its end."""
        loop = asyncio.get_running_loop()
        waiting: asyncio.Queue[tuple[float, bytes]] = asyncio.Queue(_WAITING)

        async def read() -> None:
            while data := await reader.read(_CHUNK_BYTES):
                await waiting.put((loop.time() + self.delay_s, data))
            await waiting.put((loop.time(), b""))

        reading = background(read(), "slow link")
        try:
            while True:
                due_s, data = await waiting.get()
                await asyncio.sleep(max(0.0, due_s - loop.time()))
                if not data:
                    return
                writer.write(data)
                await writer.drain()
        finally:
            await end(reading)
            with contextlib.suppress(OSError):
                writer.close()
