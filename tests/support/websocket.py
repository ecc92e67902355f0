"""A bare WebSocket client: whatever a hostile or odd peer does, tests can do with it frame by frame."""

from __future__ import annotations

import asyncio
import itertools
import json
import ssl
import struct
from types import TracebackType
from typing import Any, NamedTuple

import cbor2

from ropeway import aio
from tests.support.until import PATIENCE_S

__all__ = [
    "BINARY",
    "CLOSE",
    "CONTINUATION",
    "PING",
    "PONG",
    "TEXT",
    "Answer",
    "Client",
    "ClosedByServer",
    "Frame",
    "fetch",
    "frame",
]

CONTINUATION, TEXT, BINARY, CLOSE, PING, PONG = 0, 1, 2, 8, 9, 10
_SHORT, _LONG = struct.Struct("!H"), struct.Struct("!Q")


class ClosedByServer(Exception):  # an answer, not always a fault
    """The server closed the connection; ``code`` is 1006 where it did not say why."""

    def __init__(self, code: int, reason: str) -> None:
        self.code, self.reason = code, reason
        super().__init__(f"{code} {reason}")


class Frame(NamedTuple):
    """One whole message."""

    text: bool
    data: bytes

    @property
    def json(self) -> Any:
        return json.loads(self.data)

    @property
    def cbor(self) -> Any:
        return cbor2.loads(self.data)


def frame(opcode: int, payload: bytes, *, fin: bool = True, rsv: int = 0) -> bytes:
    """A client's frame; its mask is zero, which is as good as any other."""
    size = len(payload)
    head = bytes((opcode | rsv << 4 | (0x80 if fin else 0),))
    if size < 126:
        head += bytes((0x80 | size,))
    elif size < 65536:
        head += b"\xfe" + _SHORT.pack(size)
    else:
        head += b"\xff" + _LONG.pack(size)
    return head + bytes(4) + payload


class Client:
    """``async with Client(port) as client``. Reads only when asked to."""

    def __init__(
        self,
        port: int,
        *,
        subprotocol: str = "",
        path: str = "/",
        host: str = "127.0.0.1",
        ssl_context: ssl.SSLContext | None = None,
        receive_bytes: int = 64 << 20,
        headers: dict[str, str] | None = None,
        named: str = "",
    ) -> None:
        self._named = named or f"{host}:{port}"
        self._port, self._host, self._path, self._subprotocol = port, host, path, subprotocol
        self._ssl = ssl_context
        self._receive_bytes = receive_bytes
        self._headers = headers or {}
        self._numbers = itertools.count(1)
        self._waiting: list[Frame] = []
        self.status = ""
        self.headers: dict[str, str] = {}

    async def __aenter__(self) -> Client:
        self.reader, self.writer = await asyncio.open_connection(
            self._host, self._port, ssl=self._ssl, limit=self._receive_bytes
        )
        lines = [
            f"GET {self._path} HTTP/1.1",
            f"Host: {self._named}",
            "Upgrade: websocket",
            "Connection: Upgrade",
            "Sec-WebSocket-Version: 13",
            "Sec-WebSocket-Key: dGhlIHNhbXBsZSBub25jZQ==",
        ]
        if self._subprotocol:
            lines.append(f"Sec-WebSocket-Protocol: {self._subprotocol}")
        lines += [f"{name}: {value}" for name, value in self._headers.items()]
        self.writer.write("\r\n".join([*lines, "", ""]).encode())
        answer = (await self.reader.readuntil(b"\r\n\r\n")).decode().split("\r\n")
        self.status = answer[0]
        self.headers = dict(line.split(": ", 1) for line in answer[1:] if ": " in line)
        return self

    async def __aexit__(self, kind: type[BaseException] | None, error: object, trace: TracebackType | None) -> None:
        self.abort()

    def abort(self) -> None:
        """Leave without a word."""
        self.writer.transport.abort()

    # ── sending ────────────────────────────────────────────────────────────────────────────────────────────────

    def raw(self, data: bytes) -> None:
        self.writer.write(data)

    def send(self, op: dict[str, Any] | str | bytes) -> None:
        """A text frame."""
        data = json.dumps(op).encode() if isinstance(op, dict) else op.encode() if isinstance(op, str) else op
        self.raw(frame(TEXT, data))

    def send_binary(self, data: bytes) -> None:
        self.raw(frame(BINARY, data))

    def send_pieces(self, opcode: int, data: bytes, size: int) -> None:
        """One message in continuation frames of ``size`` bytes."""
        pieces = [data[i : i + size] for i in range(0, len(data), size)] or [b""]
        for i, piece in enumerate(pieces):
            self.raw(frame(opcode if i == 0 else CONTINUATION, piece, fin=i == len(pieces) - 1))

    # ── receiving ──────────────────────────────────────────────────────────────────────────────────────────────

    async def receive(self, timeout_s: float = PATIENCE_S) -> Frame:
        """The next message. Raises ``ClosedByServer``."""
        if self._waiting:
            return self._waiting.pop(0)
        async with aio.timeout(timeout_s):
            return await self._receive()

    async def _receive(self) -> Frame:
        parts: list[bytes] = []
        text = False
        while True:
            try:
                opcode, fin, payload = await self._frame()
            except (asyncio.IncompleteReadError, ConnectionError):
                raise ClosedByServer(1006, "") from None
            if opcode == CLOSE:
                self.raw(frame(CLOSE, payload[:2]))
                code = _SHORT.unpack(payload[:2])[0] if len(payload) >= 2 else 1005
                raise ClosedByServer(code, payload[2:].decode())
            if opcode == PING:
                self.raw(frame(PONG, payload))
            elif opcode != PONG:
                if opcode != CONTINUATION:
                    text = opcode == TEXT
                parts.append(payload)
                if fin:
                    return Frame(text, b"".join(parts))

    async def _frame(self) -> tuple[int, bool, bytes]:
        first, second = await self.reader.readexactly(2)
        size = second & 0x7F
        if size == 126:
            (size,) = _SHORT.unpack(await self.reader.readexactly(2))
        elif size == 127:
            (size,) = _LONG.unpack(await self.reader.readexactly(8))
        return first & 0x0F, bool(first & 0x80), await self.reader.readexactly(size)

    async def json(self, timeout_s: float = PATIENCE_S) -> Any:
        """The next message, which must be a text frame."""
        got = await self.receive(timeout_s)
        assert got.text, got.data[:100]
        return got.json

    async def done(self) -> None:
        """Everything that was sent so far has been carried out. What arrives meanwhile is kept for ``receive``."""
        id = f"done {next(self._numbers)}"
        self.send({"op": "call_service", "service": "/nowhere", "id": id})
        kept: list[Frame] = []
        async with aio.timeout(PATIENCE_S):
            while True:
                got = await self._receive()
                if got.text and f'"{id}"'.encode() in got.data:
                    break
                kept.append(got)
        self._waiting += kept

    async def nothing(self) -> None:
        """Nothing has arrived, and nothing is on its way that was caused before."""
        for _ in range(3):
            await self.done()
        assert not self._waiting, self._waiting[0]

    async def closed(self, timeout_s: float = PATIENCE_S) -> tuple[int, str]:
        """Wait for the server to close; gives its code and reason."""
        try:
            async with aio.timeout(timeout_s):
                while True:
                    await self._receive()
        except ClosedByServer as end:
            return end.code, end.reason


class Answer(NamedTuple):
    """An answer over plain HTTP."""

    status: int
    headers: dict[str, str]
    body: bytes


async def fetch(
    port: int, path: str, *, method: str = "GET", headers: dict[str, str] | None = None, host: str = ""
) -> Answer:
    """One request, without an upgrade."""
    named = host or f"127.0.0.1:{port}"
    reader, writer = await asyncio.open_connection("127.0.0.1", port)
    lines = [f"{method} {path} HTTP/1.1", f"Host: {named}", *(f"{n}: {v}" for n, v in (headers or {}).items())]
    writer.write("\r\n".join([*lines, "", ""]).encode())
    async with aio.timeout(PATIENCE_S):
        data = await reader.read(-1)
    writer.close()
    head, _, body = data.partition(b"\r\n\r\n")
    first, *rest = head.decode("latin-1").split("\r\n")
    return Answer(int(first.split(" ")[1]), dict(line.split(": ", 1) for line in rest), body)
