"""A cable between a gateway and its broker, which can be cut and mended."""

from __future__ import annotations

import asyncio
import contextlib

from ropeway.tasks import Chores

from .broker import Broker

__all__ = ["Cable"]


class Cable:
    """Forwards connections to a broker while it is whole."""

    def __init__(self, broker: Broker) -> None:
        self.whole = True
        self._broker = broker
        self._writers: set[asyncio.StreamWriter] = set()
        self._server: asyncio.Server | None = None
        self._chores = Chores()

    @property
    def url(self) -> str:
        """The address of the broker by this cable."""
        assert self._server is not None
        return f"mqtt://127.0.0.1:{self._server.sockets[0].getsockname()[1]}"

    def cut(self) -> None:
        """Close every connection, and take none any more."""
        self.whole = False
        for writer in list(self._writers):
            writer.transport.abort()

    async def _serve(self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        if not self.whole:
            writer.transport.abort()
            return
        far_reader, far_writer = await asyncio.open_connection("127.0.0.1", self._broker.port)
        self._writers |= {writer, far_writer}
        try:
            with contextlib.suppress(OSError):
                await asyncio.gather(_copy(reader, far_writer), _copy(far_reader, writer))
        finally:
            for end in (writer, far_writer):
                end.transport.abort()
                with contextlib.suppress(OSError):
                    await end.wait_closed()
                self._writers.discard(end)

    async def __aenter__(self) -> Cable:
        self._server = await asyncio.start_server(
            lambda *ends: self._chores.start(self._serve(*ends), "a cable") and None, "127.0.0.1", 0
        )
        return self

    async def __aexit__(self, *_: object) -> None:
        assert self._server is not None
        self._server.close()
        self.cut()
        await self._chores.wait()


async def _copy(reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
    while data := await reader.read(1 << 16):
        writer.write(data)
        await writer.drain()
    writer.transport.abort()
