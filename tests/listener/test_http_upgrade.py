"""ropeway.listener.http_upgrade: who goes on with a connection, and what a client can do before that is decided."""

from __future__ import annotations

import asyncio
import contextlib
import gc
import json
import ssl
from collections.abc import AsyncIterator
from contextlib import AsyncExitStack
from pathlib import Path
from typing import Any

import pytest

from ropeway import aio
from ropeway.listener.connection import Connection, Limits
from ropeway.listener.http import MAX_HEAD_BYTES, HttpRequest, Response, reply
from ropeway.listener.http_upgrade import Admission, HttpUpgrade
from ropeway.listener.listener import Listener
from ropeway.listener.lobby import Lobby
from ropeway.listener.websocket import listen
from tests.support.authority import Authority
from tests.support.until import PATIENCE_S, until
from tests.support.websocket import CLOSE, Client

UPGRADE = (
    "GET / HTTP/1.1\r\nHost: x\r\nUpgrade: websocket\r\nConnection: {connection}\r\n"
    "Sec-WebSocket-Version: {version}\r\nSec-WebSocket-Key: {key}\r\n\r\n"
)
KEY = "dGhlIHNhbXBsZSBub25jZQ=="


class Echo(asyncio.Protocol):
    """A protocol that takes a connection over: says what it got, in upper case."""

    def connection_made(self, transport: Any) -> None:
        self.transport = transport

    def data_received(self, data: bytes) -> None:
        self.transport.write(data.upper())


class Place:
    def __init__(self, stack: AsyncExitStack) -> None:
        self.stack = stack
        self.connections: list[Connection] = []
        self.requests: list[HttpRequest] = []
        self.server: Listener
        self.tls: ssl.SSLContext | None = None

    def answer(self, request: HttpRequest) -> Response | asyncio.Protocol:
        self.requests.append(request)
        if request.path == "/echo":
            return Echo()
        if request.path == "/broken":
            raise ValueError("broken")
        return reply(200, {"path": request.path})

    async def listen(self, *, lobby: Lobby | None = None, open_timeout_s: float = PATIENCE_S, **options: Any) -> None:
        limits = Limits(ping_interval_s=None, open_timeout_s=open_timeout_s)
        self.lobby = Lobby() if lobby is None else lobby
        self.server = await listen(
            "127.0.0.1", 0, self.connections.append, limits=limits, http=self.answer, lobby=self.lobby, **options
        )
        self.stack.push_async_callback(self.server.close)

    async def open(self) -> tuple[asyncio.StreamReader, asyncio.StreamWriter]:
        reader, writer = await asyncio.open_connection("127.0.0.1", self.server.port, ssl=self.tls)

        async def leave() -> None:
            writer.transport.abort()
            with contextlib.suppress(ConnectionError):
                await writer.wait_closed()

        self.stack.push_async_callback(leave)
        return reader, writer

    async def ask(self, text: str | bytes) -> tuple[int, bytes]:
        """Send ``text``; the status of the answer, and its body."""
        reader, writer = await self.open()
        writer.write(text if isinstance(text, bytes) else text.encode("latin-1"))
        async with aio.timeout(PATIENCE_S):
            data = await reader.read(-1)
        head, _, body = data.partition(b"\r\n\r\n")
        return int(head.split(b" ")[1]), body


@pytest.fixture
async def place() -> AsyncIterator[Place]:
    async with AsyncExitStack() as stack:
        made = Place(stack)
        yield made
        for connection in made.connections:
            connection.abort("the test is over")
            await connection.wait_closed()


@pytest.fixture(params=["ws", "wss"])
async def both(place: Place, request: pytest.FixtureRequest, tmp_path: Path) -> Place:
    """Without and with TLS."""
    if request.param == "ws":
        await place.listen()
        return place
    authority = Authority(tmp_path, "ours")
    files = authority.sign("server")
    context = ssl.SSLContext(ssl.PROTOCOL_TLS_SERVER)
    context.load_cert_chain(files["certificate"], files["key"])
    place.tls = ssl.create_default_context(cafile=authority.file)
    await place.listen(ssl_context=context)
    return place


async def test_plain_requests(both: Place) -> None:
    """A request that is no WebSocket is answered by ``http``; a HEAD without the body; HTTP/1.0 as well."""
    assert await both.ask("GET /a HTTP/1.1\r\nHost: x\r\n\r\n") == (200, b'{"path": "/a"}\n')
    assert await both.ask("HEAD /a HTTP/1.1\r\nHost: x\r\n\r\n") == (200, b"")
    assert await both.ask("GET /a HTTP/1.0\r\n\r\n") == (200, b'{"path": "/a"}\n')
    request = both.requests[0]
    assert request.peer.startswith("127.0.0.1:")
    assert request.secure is (both.tls is not None)
    assert not both.connections


async def test_another_protocol(both: Place) -> None:
    """``http`` may give the connection away: the other protocol gets the request, and all that follows."""
    reader, writer = await both.open()
    writer.write(b"POST /echo HTTP/1.1\r\nHost: x\r\n\r\nmore")
    async with aio.timeout(PATIENCE_S):
        await reader.readuntil(b"MORE")
        for word in (b"and", b"further"):
            writer.write(word)
            assert await reader.readexactly(len(word)) == word.upper()
    gc.collect()
    left = [item for item in gc.get_objects() if isinstance(item, HttpUpgrade)]
    assert not left, "its timer would end the connection"


async def test_websocket(both: Place) -> None:
    """A WebSocket begins in the same way, also where its first frame comes with the request."""
    reader, writer = await both.open()
    text = UPGRADE.format(connection="keep-alive, Upgrade", version=13, key=KEY)
    writer.write(text.encode() + b"\x81\x82\0\0\0\0hi")
    await reader.readuntil(b"\r\n\r\n")
    await until(lambda: both.connections)
    (connection,) = both.connections
    assert connection.secure is (both.tls is not None)
    assert connection.handshake is not None
    assert connection.handshake.headers["host"] == "x"
    await until(lambda: connection.frames_in == 1)


@pytest.mark.parametrize(
    ("text", "status"),
    [
        (UPGRADE.format(connection="Upgrade", version=12, key=KEY), 426),
        (UPGRADE.format(connection="Upgrade", version=13, key="short"), 400),
        (UPGRADE.format(connection="Upgrade", version=13, key="é" * 24), 400),
        (UPGRADE.format(connection="Upgrade", version=13, key=KEY).replace("GET", "POST"), 405),
        (UPGRADE.format(connection="Upgrade", version=13, key=KEY).replace("GET /", "GET /other"), 404),
        ("nonsense\r\n\r\n", 400),
        ("GET /broken HTTP/1.1\r\n\r\n", 500),
        ("GET / HTTP/1.1\r\nx: " + "y" * MAX_HEAD_BYTES + "\r\n\r\n", 431),
        ("x" * (MAX_HEAD_BYTES + 1), 431),
    ],
)
async def test_refusals(place: Place, text: str, status: int) -> None:
    """What cannot be answered otherwise is refused with a status and a sentence in JSON, within bounds."""
    await place.listen()
    got, body = await place.ask(text)
    assert got == status
    assert json.loads(body)["error"]
    assert not place.connections


async def test_a_request_that_does_not_end(place: Place) -> None:
    """A client whose request is not complete in time is told so."""
    await place.listen(open_timeout_s=0.1)
    status, body = await place.ask("GET / HTTP/1.1\r\n")
    assert status == 408
    assert json.loads(body)["error"]
    assert not place.connections


async def test_a_body_that_nobody_wants(place: Place) -> None:
    """A client that goes on sending still reads its answer, and cannot hold the connection for ever."""
    await place.listen()
    reader, writer = await place.open()
    writer.write(b"POST / HTTP/1.1\r\nContent-Length: 100000000\r\n\r\n" + b"x" * 100_000)
    async with aio.timeout(PATIENCE_S):
        assert (await reader.readline()).startswith(b"HTTP/1.1 200")
        with contextlib.suppress(ConnectionError):
            while True:
                writer.write(b"x" * 10_000)
                await writer.drain()
                await asyncio.sleep(0.01)


async def test_many_who_say_nothing(place: Place) -> None:
    """Of the connections without a request only so many are kept: the oldest make room for new ones."""
    await place.listen(lobby=Lobby(limit=3), open_timeout_s=3600)
    silent = [await place.open() for _ in range(5)]
    async with aio.timeout(PATIENCE_S):
        for reader, _ in silent[:2]:
            with contextlib.suppress(ConnectionError):
                assert await reader.read() == b""
    assert await place.ask("GET / HTTP/1.1\r\n\r\n") == (200, b'{"path": "/"}\n')


async def test_admission(place: Place) -> None:
    """``admit`` refuses with any answer, or lets a client in with a subprotocol, limits and a grant of its own."""

    def admit(request: HttpRequest) -> Admission | Response:
        if "token" not in request.query:
            return reply(401, {"error": "no"}, WWW_Authenticate="Bearer")
        return Admission("chosen", Limits(ping_interval_s=None, max_message_bytes=2000), "the grant")

    await place.listen(admit=admit, path="/ros")
    async with Client(place.server.port, path="/ros") as client:
        assert client.status == "HTTP/1.1 401 Unauthorized"
        assert client.headers["WWW-Authenticate"] == "Bearer"
    async with Client(place.server.port, path="/ros/?token=1") as client:
        assert client.status == "HTTP/1.1 101 Switching Protocols"
        assert client.headers["Sec-WebSocket-Protocol"] == "chosen"
        await until(lambda: place.connections)
        assert place.connections[0].grant == "the grant"
        client.send("x" * 3000)
        assert (await client.closed())[0] == 1009
        client.raw(bytes((0x80 | CLOSE, 0x80, 0, 0, 0, 0)))


async def test_closing(place: Place) -> None:
    """A server that stops drops those who have not said what they want."""
    await place.listen()
    reader, _ = await place.open()
    await until(lambda: len(place.lobby) == 1)
    await place.server.close()
    with contextlib.suppress(ConnectionError):
        assert await reader.read() == b""
