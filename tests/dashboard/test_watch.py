"""A gateway as a dashboard watches it."""

from __future__ import annotations

import asyncio
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager

import pytest

from ropeway.control.client import ControlTarget
from ropeway.dashboard.watch import GatewayWatch
from ropeway.dashboard.watch_list import WatchList
from tests.control.conftest import Begin
from tests.support.until import until

GARBAGE = {
    "no HTTP": b"\x00\xff" * 50,
    "no JSON": b"HTTP/1.1 200 OK\r\nContent-Type: application/json\r\nContent-Length: 3\r\n\r\n{{{",
    "another shape": b"HTTP/1.1 200 OK\r\nContent-Type: application/json\r\nContent-Length: 2\r\n\r\n[]",
    "a page": b"HTTP/1.1 200 OK\r\nContent-Type: text/html\r\nContent-Length: 4\r\n\r\n<b/>",
    "a redirection": b"HTTP/1.1 302 Found\r\nLocation: http://evil.example/\r\nContent-Length: 0\r\n\r\n",
    "an error of another shape": b"HTTP/1.1 422 X\r\nContent-Type: application/json\r\nContent-Length: 19\r\n\r\n"
    b'{"problems": "xyz"}',
    "deep": b"HTTP/1.1 200 OK\r\nContent-Type: application/json\r\nContent-Length: 200000\r\n\r\n" + b"[" * 200_000,
    "nothing": b"",
    "bytes without end": b"HTTP/1.1 200 OK\r\nContent-Type: application/json\r\n\r\n" + b" " * (17 << 20),
}


@asynccontextmanager
async def answering(answer: bytes) -> AsyncIterator[ControlTarget]:
    """Something at an address that answers everything the same."""

    async def serve(reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        try:
            await reader.read(1000)
            writer.write(answer)
            await writer.drain()
        except OSError:
            pass
        finally:
            writer.close()

    server = await asyncio.start_server(serve, "127.0.0.1", 0)
    async with server:
        yield ControlTarget("x", f"http://127.0.0.1:{server.sockets[0].getsockname()[1]}")


@pytest.mark.parametrize("kind", GARBAGE)
async def test_garbage(kind: str) -> None:
    """A gateway that answers garbage is one that has an error, and is asked again later."""
    async with answering(GARBAGE[kind]) as target:
        watch = GatewayWatch("x", target)
        try:
            await watch.answered.wait()
            assert watch.error
            assert watch.status is None
        finally:
            await watch.close()


async def test_a_gateway_is_asked_only_while_somebody_looks(begin: Begin) -> None:
    """A gateway at which nobody looks any more is not asked, and is asked at once when somebody does."""
    now = 0.0
    robot = await begin()
    watch = GatewayWatch("robot", robot.target, clock=lambda: now)
    try:
        await until(lambda: watch.status)
        now = 100.0
        await until(lambda: watch.resting)
        asked = watch.asked
        watch.look()
        await until(lambda: watch.asked > asked)
    finally:
        await watch.close()


async def test_rights_of_a_role(begin: Begin, monkeypatch: pytest.MonkeyPatch) -> None:
    """A watch with a token knows the rights of its role, and a wrong one shows the refusal."""
    monkeypatch.setenv("WATCHER", "0123456789abcdef")
    robot = await begin(
        control={"listen": ["http://127.0.0.1:0"]},
        auth={
            "tokens": [{"token": {"env": "WATCHER"}, "role": "watcher"}],
            "roles": {"watcher": {"control": ["observe"]}},
        },
    )
    fleet = WatchList([ControlTarget("robot", robot.control.addresses[0]), robot.target])
    try:
        assert await fleet.knows("0123456789abcdef")
        assert not await fleet.knows("wrong")
        (watch,) = fleet.watches("0123456789abcdef")  # the socket is for who has the key
        await watch.answered.wait()
        assert watch.may("observe")
        assert not watch.may("configure")
        (wrong,) = fleet.watches("wrong")
        await wrong.answered.wait()
        assert "token" in wrong.error
        assert len(fleet.watches()) == 2
    finally:
        await fleet.close()
