"""ropeway.control.on_demand: a socket whose server begins with its first connection."""

from __future__ import annotations

import asyncio
import json
import socket
import subprocess
import sys
from collections.abc import Awaitable, Callable, Iterator
from pathlib import Path

import pytest

from ropeway import tasks
from ropeway.control.on_demand import ClosableServer, ServedOnDemand


@pytest.fixture
def bound(tmp_path: Path) -> Iterator[socket.socket]:
    """A socket that listens."""
    with socket.socket(socket.AF_UNIX) as made:
        made.setblocking(False)
        made.bind(str(tmp_path / "s"))
        made.listen(8)
        yield made


def echoing(bound: socket.socket, begun: list[int], *, failures: int = 0) -> Callable[[], Awaitable[ClosableServer]]:
    """What begins to answer with ``hello``, after some failures."""

    class Hello:
        def __init__(self, server: asyncio.Server) -> None:
            self._server = server

        async def close(self) -> None:
            self._server.close()
            begun.append(-1)

    async def greet(_: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        writer.write(b"hello")
        writer.close()
        await writer.wait_closed()

    async def begin() -> ClosableServer:
        begun.append(len(begun))
        if len(begun) <= failures:
            raise OSError("not yet")
        return Hello(await asyncio.start_unix_server(greet, sock=bound))

    return begin


async def greeting(bound: socket.socket) -> bytes:
    """What a caller gets."""
    reader, writer = await asyncio.open_unix_connection(bound.getsockname())
    try:
        return await reader.read()
    finally:
        writer.close()


async def test_begins_with_the_first_connection(bound: socket.socket) -> None:
    """Nothing is begun before anybody comes; those that come meanwhile are all answered, and it is begun once."""
    begun: list[int] = []
    served = ServedOnDemand(bound, echoing(bound, begun))
    await asyncio.sleep(0)
    assert begun == []
    assert await asyncio.gather(*(greeting(bound) for _ in range(5))) == [b"hello"] * 5
    assert await greeting(bound) == b"hello"
    await served.close()
    assert begun == [0, -1]


async def test_begins_again(
    bound: socket.socket, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    """What cannot begin says so, and begins again for those that wait."""
    monkeypatch.setattr(
        tasks.Supervised.__init__, "__kwdefaults__", {"on_failure": None, "pause_s": 0.01, "longest_pause_s": 0.02}
    )
    begun: list[int] = []
    served = ServedOnDemand(bound, echoing(bound, begun, failures=2))
    assert await greeting(bound) == b"hello"
    assert "begin to answer on the control API failed" in caplog.text
    await served.close()
    assert begun == [0, 1, 2, -1]


async def test_nobody_comes(bound: socket.socket) -> None:
    """What nobody asked ends without having begun."""
    begun: list[int] = []
    served = ServedOnDemand(bound, echoing(bound, begun))
    await served.close()
    await served.close()
    assert begun == []


def test_a_gateway_that_nobody_asks_loads_no_web_server(tmp_path: Path) -> None:
    """``ropeway run`` has a control API, and loads what answers HTTP only when somebody asks."""
    path = tmp_path / "gateway.json"
    path.write_text(json.dumps({"gateway": {"graphs": ["memory:quiet"], "listen": []}}))
    program = f"""
import sys
from ropeway.cli import app
try:
    app(["run", {str(path)!r}, "--quiet", "--for", "0.2"])
finally:
    print([name for name in ("ropeway.control.control", "starlette", "uvicorn") if name in sys.modules])
"""
    done = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, check=False, timeout=120)
    assert done.stdout.splitlines()[-1:] == ["['ropeway.control.control']"], done.stderr
