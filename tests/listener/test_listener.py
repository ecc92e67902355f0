"""ropeway.listener.listener: accepting connections, also where there is hardly room for them."""

from __future__ import annotations

import asyncio
import contextlib
import errno
import gc
import logging
import resource
import socket
import ssl
import weakref
from collections.abc import AsyncIterator
from typing import Any

import aiofastnet.api_utils
import pytest

from ropeway import aio
from ropeway.errors import ConnectFailed
from ropeway.listener.listener import Listener, open_listener
from ropeway.listener.lobby import Lobby, Visit
from tests.support.until import PATIENCE_S, until


class Echo(asyncio.Protocol):
    def __init__(self, visit: Visit) -> None:
        self.visit = visit

    def connection_made(self, transport: Any) -> None:
        self.transport = transport
        self.visit.drop = transport.abort

    def data_received(self, data: bytes) -> None:
        self.visit.leave()
        self.transport.write(data)

    def connection_lost(self, exc: Exception | None) -> None:
        self.visit.leave()


@contextlib.asynccontextmanager
async def listening(lobby: Lobby, context: ssl.SSLContext | None = None) -> AsyncIterator[Listener]:
    made = await open_listener("test://x", "127.0.0.1", 0, Echo, lobby=lobby, handshake_s=5.0, context=context)
    try:
        yield made
    finally:
        await made.close()


async def echoed(port: int) -> bool:
    reader, writer = await asyncio.open_connection("127.0.0.1", port)
    writer.write(b"x")
    got = await reader.read(1)
    writer.transport.abort()
    return got == b"x"


async def test_half_open_tls() -> None:
    """A TLS handshake that is not finished counts as waiting; where too many wait, the oldest is dropped."""
    lobby = Lobby(limit=3)
    async with listening(lobby, ssl.SSLContext(ssl.PROTOCOL_TLS_SERVER)) as listener:
        opened = [await asyncio.open_connection("127.0.0.1", listener.port) for _ in range(5)]
        async with aio.timeout(PATIENCE_S):
            for reader, _ in opened[:2]:
                with contextlib.suppress(ConnectionError):
                    assert await reader.read() == b""
        assert len(lobby) == 3
        for _, writer in opened:
            writer.transport.abort()
        await until(lambda: not lobby)


@pytest.mark.parametrize("secure", [False, True])
async def test_dropped_before_its_greeting_began(secure: bool) -> None:
    """A connection that is dropped in the turn in which it was accepted is closed, and its descriptor freed."""
    lobby = Lobby()
    async with listening(lobby, ssl.SSLContext(ssl.PROTOCOL_TLS_SERVER) if secure else None) as listener:
        sockets = [socket.create_connection(("127.0.0.1", listener.port)) for _ in range(3)]
        listener._accept(listener._sockets[0])  # as the loop calls it; no greeting has begun when this returns
        assert len(lobby) == 3
        lobby.clear(listener)
        assert len(lobby) == 0
        for sock in sockets:
            sock.settimeout(5)
            assert await asyncio.to_thread(_ended, sock)
            sock.close()
        assert not listener._accepted
        if not secure:
            assert await echoed(listener.port)


def _ended(sock: socket.socket) -> bool:
    try:
        return sock.recv(1) == b""
    except ConnectionResetError:
        return True


async def test_what_a_dropped_handshake_held() -> None:
    """Nothing of a TLS handshake stays once it is dropped, however long it might have taken."""
    lobby, before = Lobby(limit=2), _handshakes()
    async with listening(lobby, ssl.SSLContext(ssl.PROTOCOL_TLS_SERVER)) as listener:
        opened = [await asyncio.open_connection("127.0.0.1", listener.port) for _ in range(20)]
        for _, writer in opened:
            writer.write(b"\x16\x03\x01\x02\x00\x01")
        await until(lambda: sum(lobby.dropped.values()) == 18)
        await until(lambda: _handshakes() <= before + 2)
        for _, writer in opened:
            writer.transport.abort()
        await until(lambda: not lobby)


async def test_what_a_failed_handshake_held() -> None:
    """Nothing of a TLS handshake stays once it failed, also before the garbage collector comes by."""
    made: list[weakref.ref[Echo]] = []

    def make(visit: Visit) -> Echo:
        protocol = Echo(visit)
        made.append(weakref.ref(protocol))
        return protocol

    lobby = Lobby()
    context = ssl.SSLContext(ssl.PROTOCOL_TLS_SERVER)
    listener = await open_listener("test://x", "127.0.0.1", 0, make, lobby=lobby, handshake_s=5.0, context=context)
    gc.disable()
    try:
        for said in (b"\x16\x03\x01\x02\x00\x01", b"no TLS"):
            _, writer = await asyncio.open_connection("127.0.0.1", listener.port)
            writer.write(said)
            await until(lambda: len(lobby) == 1 and len(made) == 1)
            writer.transport.abort()
            await until(lambda: not len(lobby) and made.pop()() is None)
    finally:
        gc.enable()
        await listener.close()


def _handshakes() -> int:
    gc.collect()
    return sum(type(each).__name__.startswith("SSLTransport") for each in gc.get_objects())


async def test_out_of_open_files(caplog: pytest.LogCaptureFixture) -> None:
    """Without open files left, the listener rests and says so once; it accepts again when there is room."""
    caplog.set_level(logging.WARNING)
    lobby = Lobby()
    before = resource.getrlimit(resource.RLIMIT_NOFILE)
    async with listening(lobby) as listener:
        assert await echoed(listener.port)
        sockets = [socket.socket() for _ in range(3)]
        used = max(sock.fileno() for sock in sockets)
        resource.setrlimit(resource.RLIMIT_NOFILE, (used + 1, before[1]))
        try:
            for sock in sockets:
                sock.setblocking(False)
                with contextlib.suppress(BlockingIOError):
                    sock.connect(("127.0.0.1", listener.port))
            await until(lambda: "no open files" in caplog.text or "Too many open files" in caplog.text)
            for _ in range(100):  # turns of the loop, in none of which it is tried again
                await asyncio.sleep(0)
        finally:
            resource.setrlimit(resource.RLIMIT_NOFILE, before)
        assert len([message for message in caplog.messages if "Too many open files" in message]) == 1
        assert "Traceback" not in caplog.text
        async with aio.timeout(PATIENCE_S):
            assert await echoed(listener.port)
        for sock in sockets:
            sock.close()


async def test_a_taken_port() -> None:
    """A port that is taken is an error that names the address and says what to look for."""
    async with listening(Lobby()) as listener:
        with pytest.raises(ConnectFailed, match=r"test://y.*cannot listen.*another gateway"):
            await open_listener("test://y", "127.0.0.1", listener.port, Echo, lobby=Lobby(), handshake_s=1.0)


async def test_every_address_of_a_name() -> None:
    """A name of several addresses is listened on at all of them, on one port."""
    listener = await open_listener("test://x", "localhost", 0, Echo, lobby=Lobby(), handshake_s=1.0)
    ports = {sock.getsockname()[1] for sock in listener._sockets}
    await listener.close()
    assert ports == {listener.port}


async def test_the_fault_of_aiofastnet() -> None:
    """Canary: aiofastnet still fails when it is out of open files, which is why its server is not used here."""

    class Full:
        def accept(self) -> None:
            raise OSError(errno.EMFILE, "Too many open files")

        def fileno(self) -> int:
            return -1

    loop = asyncio.get_running_loop()
    told: list[Any] = []
    loop.set_exception_handler(lambda _, context: told.append(context))
    server = aiofastnet.api_utils.Server(loop, [], asyncio.Protocol, None, 1, None, None, None, None)
    with pytest.raises(AttributeError):
        server._accept_connection(Full())
