"""Servers of IoRT nodes for tests, in this process or in one of their own that can be killed."""

from __future__ import annotations

import asyncio
import contextlib
import os
import shutil
import subprocess
import sys
from collections.abc import AsyncIterator
from pathlib import Path
from typing import Any

import pytest

from ropeway import aio
from ropeway.iort import Fault, Packet, Parser
from ropeway.listener.authentication import Door
from ropeway.listener.entrance import Entrance
from ropeway.networks.iort.server import IortServer
from ropeway.networks.iort.space import Space
from ropeway.store import Store, StoreLimits, make_backend, make_mirror
from tests.support.until import PATIENCE_S

__all__ = ["Raw", "ServerProcess", "old_python", "serving"]


class Served:
    def __init__(self, server: IortServer, store: Store, port: int) -> None:
        self.server, self.store, self.port = server, store, port
        self.url = f"iort://127.0.0.1:{port}"


@contextlib.asynccontextmanager
async def serving(
    path: str = "memory:",
    *,
    port: int = 0,
    limits: StoreLimits | None = None,
    ssl_context: Any = None,
    door: Door | None = None,
    mirror: str = "",
    **options: Any,
) -> AsyncIterator[Served]:
    store = Store(make_backend(path), mirror=make_mirror(mirror) if mirror else None, limits=limits)
    await store.open()
    server = IortServer(Space(store), entrance=Entrance(door), **options)
    scheme = "iort" if ssl_context is None else "iorts"
    try:
        bound = await server.listen(f"{scheme}://127.0.0.1:{port}", ssl_context=ssl_context)
        yield Served(server, store, bound)
    finally:
        await server.close()
        await store.close()


class Raw:
    """A node that is nothing but a socket."""

    def __init__(self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        self.reader, self.writer = reader, writer
        self._parser = Parser(64 << 20)
        self._ready: list[Packet | Fault] = []

    @classmethod
    async def connect(cls, port: int) -> Raw:
        return cls(*await asyncio.open_connection("127.0.0.1", port))

    def send(self, raw: bytes) -> None:
        self.writer.write(raw)

    async def packet(self, timeout_s: float = PATIENCE_S) -> Packet:
        async with aio.timeout(timeout_s):
            while not self._ready:
                data = await self.reader.read(65536)
                if not data:
                    raise EOFError
                self._ready += self._parser.feed(data)
        item = self._ready.pop(0)
        assert isinstance(item, Packet)
        return item

    async def ask(self, raw: bytes) -> Packet:
        self.send(raw)
        return await self.packet()

    async def closed(self, timeout_s: float = PATIENCE_S) -> bool:
        try:
            async with aio.timeout(timeout_s):
                while await self.reader.read(65536):
                    pass
        except ConnectionError:
            return True
        except TimeoutError:
            return False
        finally:
            self.writer.close()
        return True

    async def close(self) -> None:
        self.writer.close()
        with contextlib.suppress(OSError):
            await self.writer.wait_closed()


_PROGRAM = """
import asyncio, sys
from ropeway.networks.iort.space import Space
from ropeway.networks.iort.server import IortServer
from ropeway.store import Store, make_backend

async def main(path, port):
    store = Store(make_backend(path))
    await store.open()
    server = IortServer(Space(store))
    await server.listen(f"iort://127.0.0.1:{port}")
    print("ready", flush=True)
    await asyncio.Event().wait()

asyncio.run(main(sys.argv[1], int(sys.argv[2])))
"""


class ServerProcess:
    """A server in a process of its own."""

    def __init__(self, path: Path, port: int) -> None:
        self.path, self.port = path, port
        self.url = f"iort://127.0.0.1:{port}"
        self._process: subprocess.Popen[str] | None = None

    def start(self) -> None:
        command = [sys.executable, "-c", _PROGRAM, str(self.path), str(self.port)]
        self._process = subprocess.Popen(command, stdout=subprocess.PIPE, text=True)
        assert self._process.stdout is not None
        assert self._process.stdout.readline() == "ready\n"

    def kill(self) -> None:
        """As the kernel kills a process: nothing is tidied up."""
        if self._process is not None:
            self._process.kill()
            self._process.wait()
            if self._process.stdout is not None:
                self._process.stdout.close()
            self._process = None


def old_python() -> str:
    """The program of Python 3.8; the test is skipped where there is none."""
    home = Path(os.environ.get("PYENV_ROOT", "~/.pyenv")).expanduser()
    found = [*map(str, sorted(home.glob("versions/3.8.*/bin/python"))), shutil.which("python3.8")]
    for path in found:
        if path and subprocess.run([path, "-V"], capture_output=True, check=False).returncode == 0:
            return path
    pytest.skip("needs Python 3.8: pyenv install 3.8")
