"""A browser without a window, and the pages that it opens; the names of the pages all lead to this machine."""

from __future__ import annotations

import asyncio
import contextlib
import json
import shutil
from asyncio.subprocess import DEVNULL
from collections.abc import AsyncIterator, Sequence
from contextlib import asynccontextmanager
from pathlib import Path
from typing import Any, Final

from ropeway import aio
from tests.support.until import PATIENCE_S

__all__ = ["CHROMIUM", "Pages", "browser", "pages"]

CHROMIUM: Final = next(filter(None, map(shutil.which, ("chromium", "chromium-browser", "google-chrome"))), None)

_KINDS: Final = {".html": "text/html", ".js": "text/javascript", ".mjs": "text/javascript"}


class Pages:
    """One page and the scripts beside it, and what the page has told by ``POST /told``.

    Whatever else is asked for goes to the port ``behind``, where one is set: as if the page's name led there by now.
    """

    def __init__(self, page: str, scripts: Path | None = None, *, behind: int = 0) -> None:
        self.page, self.told = page, dict[str, Any]()
        self.port = 0
        self._scripts, self._behind = scripts, behind
        self._news = asyncio.Event()

    async def wait(self, name: str, timeout_s: float = PATIENCE_S) -> Any:
        """Return what the page told under a name."""
        async with aio.timeout(timeout_s):
            while name not in self.told:
                self._news.clear()
                await self._news.wait()
        return self.told[name]

    async def serve(self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        """Answer one request."""
        with contextlib.closing(writer), contextlib.suppress(OSError, asyncio.IncompleteReadError):
            head = await reader.readuntil(b"\r\n\r\n")
            method, path, *_ = head.decode().split(" ")
            if (method, path) == ("GET", "/page"):
                _answer(writer, self.page.encode(), ".html")
            elif (method, path) == ("POST", "/told"):
                length = next(int(line[15:]) for line in head.lower().split(b"\r\n") if line[:15] == b"content-length:")
                self.told.update(json.loads(await reader.readexactly(length)))
                self._news.set()
                _answer(writer, b"", ".html")
            elif self._scripts is not None and (file := self._scripts / path.lstrip("/")).is_file():
                _answer(writer, file.read_bytes(), file.suffix)
            elif self._behind:
                await _pass_on(head, reader, writer, self._behind)
            await writer.drain()


@asynccontextmanager
async def pages(page: str, scripts: Path | None = None, *, behind: int = 0) -> AsyncIterator[Pages]:
    """Serve a page, at ``/page``."""
    made = Pages(page, scripts, behind=behind)
    server = await asyncio.start_server(made.serve, "127.0.0.1", 0)
    async with server:
        made.port = server.sockets[0].getsockname()[1]
        yield made


@asynccontextmanager
async def browser(url: str, profile: Path, *, names: Sequence[str] = ()) -> AsyncIterator[None]:
    """Open a page in a browser for which some names are this machine's."""
    assert CHROMIUM is not None
    process = await asyncio.create_subprocess_exec(
        CHROMIUM,
        "--headless",
        "--no-sandbox",
        "--disable-gpu",
        "--disable-dev-shm-usage",
        "--no-first-run",
        "--disable-background-networking",
        f"--user-data-dir={profile}",
        f"--host-resolver-rules={', '.join(f'MAP {name} 127.0.0.1' for name in names)}",
        url,
        stdout=DEVNULL,
        stderr=DEVNULL,
    )
    try:
        yield
    finally:
        process.terminate()
        await process.wait()


def _answer(writer: asyncio.StreamWriter, body: bytes, suffix: str) -> None:
    kind = _KINDS.get(suffix, "text/plain")
    head = f"HTTP/1.1 200 OK\r\nContent-Type: {kind}; charset=utf-8\r\nContent-Length: {len(body)}\r\n"
    writer.write(f"{head}Connection: close\r\n\r\n".encode() + body)


async def _pass_on(head: bytes, reader: asyncio.StreamReader, writer: asyncio.StreamWriter, port: int) -> None:
    other, there = await asyncio.open_connection("127.0.0.1", port)
    there.write(head)

    async def copy(source: asyncio.StreamReader, sink: asyncio.StreamWriter) -> None:
        while data := await source.read(1 << 16):
            sink.write(data)
            await sink.drain()

    ways = [asyncio.create_task(copy(reader, there)), asyncio.create_task(copy(other, writer))]
    try:
        await asyncio.wait(ways, return_when=asyncio.FIRST_COMPLETED)
    finally:
        for way in ways:
            way.cancel()
        await asyncio.gather(*ways, return_exceptions=True)
        there.close()
