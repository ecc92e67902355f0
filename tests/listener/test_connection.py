"""ropeway.listener.connection: both roles over real sockets, and peers that misbehave frame by frame."""

from __future__ import annotations

import asyncio
import contextlib
import os
import tracemalloc
from collections import Counter
from collections.abc import AsyncIterator
from contextlib import AsyncExitStack
from time import perf_counter
from typing import Any

import pytest
from picows import WSFrame, WSMsgType, WSTransport

from ropeway import aio
from ropeway.budget import Budget
from ropeway.errors import ConnectFailed
from ropeway.listener.connection import Connection, Limits
from ropeway.listener.listener import Listener
from ropeway.listener.websocket import connect, listen
from tests.support.until import PATIENCE_S, until
from tests.support.websocket import (
    BINARY,
    CLOSE,
    CONTINUATION,
    PING,
    PONG,
    TEXT,
    Client,
    ClosedByServer,
    frame,
)

QUIET = Limits(ping_interval_s=None, max_message_bytes=100_000, open_timeout_s=1.0)


class End:
    """One end of a connection and what it was told."""

    def __init__(self, connection: Connection) -> None:
        self.connection = connection
        self.got: list[tuple[str, bytes]] = []
        self.ends: list[tuple[int, str]] = []
        self.writables = 0
        connection.on_text = lambda data: self.got.append(("text", bytes(data)))
        connection.on_binary = lambda data: self.got.append(("binary", bytes(data)))
        connection.on_closed = lambda code, reason: self.ends.append((code, reason))
        connection.on_writable = self._writable

    def _writable(self) -> None:
        self.writables += 1


class Place:
    def __init__(self, stack: AsyncExitStack) -> None:
        self.stack = stack
        self.ends: list[End] = []
        self.server: Listener

    async def listen(self, limits: Limits = QUIET, **options: Any) -> None:
        self.server = await listen("127.0.0.1", 0, lambda c: self.ends.append(End(c)), limits=limits, **options)
        self.stack.push_async_callback(self.server.close)

    @property
    def url(self) -> str:
        return f"ws://127.0.0.1:{self.server.port}"

    async def connect(self, limits: Limits = QUIET, **options: Any) -> End:
        return End(await connect(self.url, limits=limits, **options))

    async def client(self) -> tuple[Client, End]:
        """A bare client and the server's end of it."""
        count = len(self.ends)
        client = await self.stack.enter_async_context(Client(self.server.port))
        await until(lambda: len(self.ends) > count)
        return client, self.ends[-1]

    async def close(self) -> None:
        for end in self.ends:
            end.connection.abort("the test is over")
        await until(lambda: all(end.connection.closed for end in self.ends))


@pytest.fixture
async def place() -> AsyncIterator[Place]:
    async with AsyncExitStack() as stack:
        made = Place(stack)
        stack.push_async_callback(made.close)
        yield made


# ── both roles ─────────────────────────────────────────────────────────────────────────────────────────────────────


async def test_messages(place: Place) -> None:
    """Texts and bytes of every size pass whole and in order, both ways, and are counted."""
    await place.listen(subprotocols=("ropeway.1",))
    near = await place.connect(subprotocols=("other", "ropeway.1"))
    (far,) = place.ends
    assert near.connection.subprotocol == far.connection.subprotocol == "ropeway.1"
    assert near.connection.peer == place.url
    assert far.connection.peer.startswith("127.0.0.1:")
    assert far.connection.handshake is not None
    assert far.connection.handshake.subprotocols == ("other", "ropeway.1")
    sizes = (0, 1, 125, 126, 65535, 65536, 100_000)
    for sender, receiver in ((near, far), (far, near)):
        for size in sizes:
            data = os.urandom(size // 2).hex().encode().ljust(size, b"x")
            sender.connection.send_text(data)
            sender.connection.send_binary(memoryview(data))
            await until(lambda r=receiver: len(r.got) == 2)
            assert receiver.got == [("text", data), ("binary", data)]
            receiver.got.clear()
        assert receiver.connection.frames_in == sender.connection.frames_out == 2 * len(sizes)
        assert receiver.connection.bytes_in == sender.connection.bytes_out == 2 * sum(sizes)
    near.connection.close(1000, "done")
    assert await far.connection.wait_closed() == (1000, "done")
    assert await near.connection.wait_closed() == (1000, "done")
    assert near.ends == far.ends == [(1000, "done")]
    near.connection.send_text(b"too late")
    near.connection.close()
    assert near.connection.frames_out == 2 * len(sizes)


@pytest.mark.parametrize("size", [0, 1000, (1 << 16) - 14, (1 << 16) - 13, 1 << 16, 3 << 20])
async def test_parts(place: Place, size: int) -> None:
    """Two parts arrive as one binary frame, whoever sends them and however large they are, between others in order."""
    await place.listen(Limits(ping_interval_s=None))
    near = await place.connect(Limits(ping_interval_s=None))
    await until(lambda: place.ends)
    (far,) = place.ends
    head, body = b"thirteen bytes", os.urandom(size)
    for sender, receiver in ((near, far), (far, near)):
        sender.connection.send_text(b"before")
        sender.connection.send_binary_parts(head, body)
        sender.connection.send_text(b"after")
        await until(lambda r=receiver: len(r.got) == 3)
        assert receiver.got == [("text", b"before"), ("binary", head + body), ("text", b"after")]
        assert sender.connection.bytes_out == receiver.connection.bytes_in == len(head + body) + 11
        assert sender.connection.frames_out == 3
    near.connection.close()
    await far.connection.wait_closed()
    far.connection.send_binary_parts(head, body)
    assert far.connection.frames_out == 3


async def test_parts_are_not_copied(place: Place) -> None:
    """A large message that two peers do not read yet is held once, not once for each of them."""
    await place.listen(Limits(ping_interval_s=None))
    clients = [await place.client() for _ in range(2)]
    body = bytes(32 << 20)
    tracemalloc.start()
    try:
        for _, end in clients:
            end.connection.send_binary_parts(b"head", body)
            assert end.connection.unsent_bytes > 16 << 20
        _, peak = tracemalloc.get_traced_memory()
    finally:
        tracemalloc.stop()
    assert peak < 1 << 20


async def test_holding_back(place: Place) -> None:
    """A connection whose peer does not read says so, and says again when it can take more."""
    await place.listen(Limits(ping_interval_s=None))
    client, far = await place.client()
    connection = far.connection
    for _ in range(3):
        sent = 0
        while connection.writable:
            connection.send_binary(bytes(65536))
            sent += 65536
            assert sent < 64 << 20
        if connection.flow.known:  # elsewhere only the operating system's buffer holds anything back
            assert connection.unsent_bytes == 0, "what waits can still be replaced"
        before = far.writables
        while sent > 0:
            sent -= len((await client.receive()).data)
        await until(lambda: connection.writable)
        assert far.writables > before


async def test_not_reading(place: Place) -> None:
    """A connection that pauses takes nothing more from its peer, until it goes on."""
    await place.listen()
    client, far = await place.client()
    far.connection.pause_reading()
    for i in range(200):
        client.send(str(i))
    await asyncio.sleep(0.05)
    held = len(far.got)
    assert held < 200
    far.connection.resume_reading()
    await until(lambda: len(far.got) == 200)
    assert [data for _, data in far.got] == [str(i).encode() for i in range(200)]


async def test_pings(place: Place) -> None:
    """Pings are answered with what they carry, also between the pieces of a message."""
    await place.listen()
    client, far = await place.client()
    client.raw(frame(TEXT, b"one ", fin=False) + frame(PING, b"are you there?") + frame(CONTINUATION, b"text"))
    async with aio.timeout(PATIENCE_S):
        assert await client._frame() == (PONG, True, b"are you there?")
    await until(lambda: far.got == [("text", b"one text")])


async def test_sends_pings(place: Place, monkeypatch: pytest.MonkeyPatch) -> None:
    """The connection asks its peer for signs of life, and lives on while the answers come."""
    answers: Counter[Connection] = Counter()
    on_frame = Connection.on_ws_frame

    def count(connection: Connection, transport: WSTransport, frame: WSFrame) -> None:
        answers[connection] += frame.msg_type == WSMsgType.PONG
        on_frame(connection, transport, frame)

    monkeypatch.setattr(Connection, "on_ws_frame", count)
    await place.listen(Limits(ping_interval_s=0.02, silence_s=0.1))
    near = await place.connect(Limits(ping_interval_s=0.02, silence_s=0.1))
    await until(lambda: len(answers) == 2 and min(answers.values()) > 20)  # which takes longer than a silence may
    assert not near.connection.closed
    assert not place.ends[0].connection.closed
    near.connection.close()
    await near.connection.wait_closed()


# ── peers that are not there ───────────────────────────────────────────────────────────────────────────────────────


async def test_silent_peer(place: Place) -> None:
    """A peer that says nothing for the time given is given up, with the reason told."""
    await place.listen(Limits(ping_interval_s=0.02, silence_s=0.2))
    _, far = await place.client()
    assert await far.connection.wait_closed() == (1006, "nothing was heard for 0.2 s")


async def test_our_own_pause(place: Place, monkeypatch: pytest.MonkeyPatch) -> None:
    """Time in which our own process did not run is no silence of the peer, which is given up for its own alone."""
    ahead_s = 0.0
    monkeypatch.setattr("ropeway.listener.connection.time.monotonic", lambda: perf_counter() + ahead_s)
    await place.listen(Limits(ping_interval_s=0.02, silence_s=5.0))
    client, far = await place.client()
    pongs = place.ends[0].connection.frames_in
    for _ in range(3):
        ahead_s += 60.0  # the process was stopped for a minute
        await client._frame()
        await client._frame()
    assert not far.connection.closed
    assert far.connection.frames_in == pongs
    ahead_s = 0.0
    client.writer.transport.abort()
    await far.connection.wait_closed()


async def test_a_peer_that_is_not_listened_to(place: Place) -> None:
    """A peer is not given up for its silence while we take nothing from it, but is from then on."""
    await place.listen(Limits(ping_interval_s=0.02, silence_s=0.1))
    client, far = await place.client()
    far.connection.pause_reading()
    for _ in range(25):  # pings, in several times as long as a silence may be
        assert (await client._frame())[0] == PING
    assert not far.connection.closed
    far.connection.resume_reading()
    assert await far.connection.wait_closed() == (1006, "nothing was heard for 0.1 s")


async def test_half_a_frame(place: Place) -> None:
    """A frame that comes slowly is a sign of life; one that stops in the middle is not."""
    await place.listen(Limits(ping_interval_s=0.02, silence_s=0.25))
    client, far = await place.client()
    if not far.connection.flow.known:
        pytest.skip("needs an operating system that tells what it has received of a frame")
    data = frame(TEXT, b"0123456789")
    for i in range(len(data)):
        client.raw(data[i : i + 1])
        await asyncio.sleep(0.05)
    assert far.got == [("text", b"0123456789")]
    client.raw(data[:-3])
    code, reason = await far.connection.wait_closed()
    assert (code, reason) == (1006, "nothing was heard for 0.25 s")
    assert len(far.got) == 1


async def test_nobody_answers() -> None:
    """Connecting to nobody fails at once, and may be tried again."""
    probe = await asyncio.start_server(lambda r, w: None, "127.0.0.1", 0)
    port = probe.sockets[0].getsockname()[1]
    probe.close()
    with pytest.raises(ConnectFailed, match=f"ws://127.0.0.1:{port}: Connection refused") as failed:
        await connect(f"ws://127.0.0.1:{port}", limits=QUIET)
    assert failed.value.retryable


@pytest.mark.parametrize(
    ("answer", "retryable", "reason"),
    [
        (b"HTTP/1.1 404 Not Found\r\n\r\n", False, "answered HTTP 404"),
        (b"HTTP/1.1 503 Service Unavailable\r\n\r\n", True, "answered HTTP 503"),
        (b"SSH-2.0-OpenSSH_9.6\r\n\r\n", True, "is not a WebSocket server"),
        (b"HTTP/1.1 200 OK\r\nContent-Length: 2\r\n\r\nhi", True, "answered HTTP 200"),
        (b"", True, "no answer in time"),
    ],
)
async def test_odd_answers(answer: bytes, retryable: bool, reason: str) -> None:
    """An answer that is none of a WebSocket server fails with what it was, and whether to try again."""
    writers = []

    async def reply(reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        await reader.readuntil(b"\r\n\r\n")
        writer.write(answer)
        writers.append(writer)

    server = await asyncio.start_server(reply, "127.0.0.1", 0)
    async with server:
        port = server.sockets[0].getsockname()[1]
        with pytest.raises(ConnectFailed, match=reason) as failed:
            await connect(f"ws://127.0.0.1:{port}", limits=QUIET)
        assert failed.value.retryable is retryable
        for writer in writers:
            writer.close()
            with contextlib.suppress(ConnectionError):
                await writer.wait_closed()


@pytest.mark.parametrize("status", [301, 302, 303, 307, 308])
async def test_redirects(status: int) -> None:
    """A redirect is not followed, so that no other host is reached and none learns the token."""
    reached: list[bytes] = []

    async def elsewhere(reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        reached.append(await reader.read(1000))
        writer.close()

    async with await asyncio.start_server(elsewhere, "127.0.0.1", 0) as other:
        target = f"ws://127.0.0.1:{other.sockets[0].getsockname()[1]}/inside"

        async def redirect(reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
            await reader.readuntil(b"\r\n\r\n")
            writer.write(f"HTTP/1.1 {status} Moved\r\nLocation: {target}\r\nContent-Length: 0\r\n\r\n".encode())
            writer.close()

        async with await asyncio.start_server(redirect, "127.0.0.1", 0) as server:
            url = f"ws://127.0.0.1:{server.sockets[0].getsockname()[1]}"
            with pytest.raises(ConnectFailed, match=f"{status}: it points to {target}") as failed:
                await connect(url, limits=QUIET, headers={"Authorization": "Bearer s3cret"})
    assert not failed.value.retryable
    assert reached == []


async def test_hangs_up(place: Place) -> None:
    """A server that hangs up in the middle of the handshake has not answered, and may be tried again."""
    for answer in (b"", b"HTTP/1.1 101 Swit"):

        async def reply(reader: asyncio.StreamReader, writer: asyncio.StreamWriter, data: bytes = answer) -> None:
            await reader.readuntil(b"\r\n\r\n")
            writer.write(data)
            writer.close()
            await writer.wait_closed()

        server = await asyncio.start_server(reply, "127.0.0.1", 0)
        async with server:
            port = server.sockets[0].getsockname()[1]
            with pytest.raises(ConnectFailed, match="closed the connection during the handshake") as failed:
                await connect(f"ws://127.0.0.1:{port}", limits=QUIET)
            assert failed.value.retryable


async def test_taken_port(place: Place) -> None:
    """A port that is taken says so, and that another gateway may be running."""
    await place.listen()
    with pytest.raises(ConnectFailed, match="is another gateway running") as failed:
        await listen("127.0.0.1", place.server.port, lambda _: None, limits=QUIET)
    assert not failed.value.retryable


async def test_shared_port(place: Place) -> None:
    """Workers may share a port."""
    await place.listen(reuse_port=True)
    other = await listen("127.0.0.1", place.server.port, lambda _: None, limits=QUIET, reuse_port=True)
    await other.close()


# ── peers that misbehave ───────────────────────────────────────────────────────────────────────────────────────────


@pytest.mark.parametrize("size", [100_001, 1 << 40])
async def test_frame_too_big(place: Place, size: int) -> None:
    """A frame above the limit is refused by its header alone: 1009 and the limit."""
    await place.listen()
    client, far = await place.client()
    client.send("before")
    client.raw(b"\x81\xff" + size.to_bytes(8, "big") + bytes(4) + b"x" * 50_000)
    code, reason = await client.closed()
    assert code == 1009
    assert "100000" in reason
    assert (await far.connection.wait_closed())[0] == 1009


async def test_sender_of_a_big_frame_learns_why(place: Place) -> None:
    """A peer that goes on sending a message above the limit still gets to read 1009 and the reason."""
    await place.listen()
    client, _ = await place.client()
    client.send(b"x" * 20_000_000)
    code, reason = await client.closed()
    assert code == 1009
    assert "100000" in reason


async def test_pieces_too_big(place: Place) -> None:
    """Pieces that are above the limit together are refused with 1009; what still comes is not looked at."""
    await place.listen()
    client, far = await place.client()
    client.send_pieces(BINARY, b"x" * 100_000, 1024)
    await until(lambda: far.got)
    assert far.got.pop() == ("binary", b"x" * 100_000)
    client.send_pieces(BINARY, b"x" * 300_000, 1024)
    client.send("after")
    assert await client.closed() == (1009, "a message may have 100000 bytes at most")
    assert await far.connection.wait_closed() == (1009, "a message may have 100000 bytes at most")
    assert far.got == []
    assert far.ends == [(1009, "a message may have 100000 bytes at most")]


async def test_tiny_pieces(place: Place) -> None:
    """Endless pieces of nothing, or of one byte, take no more memory than what they say."""
    await place.listen()
    client, far = await place.client()
    client.raw(frame(TEXT, b"", fin=False))
    empty, one = frame(CONTINUATION, b"", fin=False), frame(CONTINUATION, b"x", fin=False)
    client.raw(empty)
    await client.writer.drain()
    tracemalloc.start()
    try:
        for _ in range(100):
            client.raw(empty * 1000 + one * 500)
            await client.writer.drain()
        client.raw(frame(CONTINUATION, b"", fin=True))
        await until(lambda: far.got, 3 * PATIENCE_S)
        assert tracemalloc.get_traced_memory()[1] < 2_000_000
    finally:
        tracemalloc.stop()
    assert far.got == [("text", b"x" * 50_000)]


@pytest.mark.parametrize(
    ("data", "code"),
    [
        (frame(CONTINUATION, b"x"), 1002),
        (frame(TEXT, b"x", fin=False) + frame(TEXT, b"y"), 1002),
        (frame(3, b"x"), 1002),
        (frame(PING, b"x", fin=False), 1002),
        (b"\x81\x05hello", 1002),
        (frame(CLOSE, b"\x03\xe7"), 1002),
        (frame(CLOSE, b"x"), 1002),
        (frame(CLOSE, b"\x03\xe8\xff"), 1007),
    ],
)
async def test_broken_frames(place: Place, data: bytes, code: int) -> None:
    """What breaks the rules of WebSockets ends the connection with the code for it, and nothing of it is delivered."""
    await place.listen()
    client, far = await place.client()
    client.raw(data)
    with pytest.raises(ClosedByServer) as end:
        await client.receive()
    assert end.value.code == code
    await until(lambda: far.connection.closed)
    assert far.got == []


@pytest.mark.parametrize("rsv", [1, 2, 4, 7])
async def test_reserved_bits(place: Place, rsv: int) -> None:
    """A frame of an extension that was not agreed upon ends the connection, whatever it is."""
    await place.listen()
    client, end = await place.client()
    client.raw(frame(TEXT, b"hello", rsv=rsv) + frame(TEXT, b"again"))
    assert (await client.closed())[0] == 1002
    assert end.got == []


async def test_nothing_is_read(place: Place, monkeypatch: pytest.MonkeyPatch) -> None:
    """Who reads nothing of much that waits is closed after a while; who reads slowly is not."""
    monkeypatch.setattr("ropeway.listener.connection.UNREAD_S", 0.0)
    await place.listen()
    client, end = await place.client()
    connection = end.connection
    connection.send_binary(bytes(32 << 20))
    connection.look()
    unsent = connection.unsent_bytes
    assert unsent > 1 << 20
    await client.reader.readexactly(16 << 20)
    await until(lambda: connection.unsent_bytes < unsent)
    connection.look()
    assert connection._closing is None
    while not end.ends:
        connection.look()
        await asyncio.sleep(0.01)
    assert end.ends[0][0] == 1008
    assert "was read" in end.ends[0][1]


async def test_too_much_is_held(place: Place) -> None:
    """A connection for which too much is held is closed, and what was held is gone with it."""
    budget = Budget(account_limit_bytes=1 << 20)
    await place.listen(Limits(ping_interval_s=None, max_message_bytes=8 << 20, budget=budget))
    client, end = await place.client()
    client.raw(frame(TEXT, bytes(900_000), fin=False))
    client.raw(frame(CONTINUATION, bytes(300_000), fin=False))
    code, reason = await client.closed()
    assert code == 1008
    assert "unfinished messages" in reason
    await until(lambda: bool(end.ends))
    assert budget.held_bytes == 0
    assert budget.ended == {"connection": 1}


async def test_unread_answers_to_pings(place: Place) -> None:
    """A peer that pings without reading the answers costs a bounded amount of memory."""
    await place.listen()
    client, far = await place.client()
    flood = frame(PING, b"x" * 125) * 1000
    for _ in range(100):
        client.raw(flood)
        await client.writer.drain()
    await until(lambda: far.connection.bytes_in >= 12_500_000)
    assert far.connection.unsent_bytes < 1 << 20
    last = frame(PING, b"last")
    client.raw(last)
    await client.writer.drain()
    end = b""
    async with aio.timeout(PATIENCE_S):
        while b"last" not in end:
            end = end[-3:] + await client.reader.read(1 << 20)


async def test_no_closing_handshake(place: Place) -> None:
    """A peer that does not answer a close is dropped within about a second."""
    await place.listen()
    client, far = await place.client()
    far.connection.close(1001, "ünd so weiter " + "x" * 500)
    async with aio.timeout(PATIENCE_S):
        code, _ = await far.connection.wait_closed()
    assert code == 1001
    opcode, _, payload = await client._frame()
    assert (opcode, payload[:2]) == (CLOSE, b"\x03\xe9")


async def test_stalled_peer_at_the_close(place: Place) -> None:
    """A peer that does not read cannot keep a connection open that is to be closed."""
    await place.listen(Limits(ping_interval_s=None))
    _, far = await place.client()
    while far.connection.writable:
        far.connection.send_binary(bytes(1 << 20))
    far.connection.close(1000)
    async with aio.timeout(PATIENCE_S):
        await far.connection.wait_closed()


async def test_endless_request(place: Place) -> None:
    """A request without an end, and one that never comes, are given up."""
    await place.listen()
    reader, writer = await asyncio.open_connection("127.0.0.1", place.server.port)
    writer.write(b"GET / HTTP/1.1\r\n" + b"X: y\r\n" * 10_000)
    with contextlib.suppress(ConnectionError):
        assert len(await reader.read()) < 10_000
    writer.transport.abort()
    reader, writer = await asyncio.open_connection("127.0.0.1", place.server.port)
    async with aio.timeout(PATIENCE_S):
        await reader.read()
    writer.close()
    assert place.ends == []
