"""A megabyte from those who are not let in, or only ask over HTTP: connections that say nothing, half or too much."""

from __future__ import annotations

import asyncio
import contextlib
import socket
import ssl
import struct
from collections.abc import Awaitable, Callable
from contextlib import AsyncExitStack
from typing import Final

__all__ = ["AT_ROUTERS", "STRANGERS", "Strangers", "abort"]

_FEW: Final = 20  # as many as come before it is measured
_CLIENT_HELLO: Final = b"\x16\x03\x01\x02\x00\x01\x00\x01\xfc\x03\x03" + bytes(500)  # its last bytes are missing


def _whole_hello() -> bytes:
    """What a client says first."""
    context = ssl.SSLContext(ssl.PROTOCOL_TLS_CLIENT)
    context.check_hostname, context.verify_mode = False, ssl.CERT_NONE
    sent = ssl.MemoryBIO()
    with contextlib.suppress(ssl.SSLWantReadError):
        context.wrap_bio(ssl.MemoryBIO(), sent).do_handshake()
    return sent.read()


_HELLO: Final = _whole_hello()

Strangers = Callable[[int, AsyncExitStack, bool], Awaitable[None]]
"""Comes to a port, with a megabyte or if the last is true with little; the stack leaves."""


def abort(writer: asyncio.StreamWriter) -> None:
    """End a connection at once. Who has only its transport does not have it any more: its writer closes it."""
    writer.transport.abort()


async def _connections(
    port: int, stack: AsyncExitStack, count: int, say: Callable[[int], bytes], *, addresses: int = 1
) -> None:
    """Open so many connections, from so many addresses of this machine, and leave them open."""
    loop = asyncio.get_running_loop()
    for number in range(count):
        sock = stack.enter_context(socket.socket())
        sock.setblocking(False)
        if addresses > 1:
            sock.bind((f"127.0.{1 + number % addresses // 250}.{1 + number % addresses % 250}", 0))
        with contextlib.suppress(OSError):  # dropped, to make room for others
            await loop.sock_connect(sock, ("127.0.0.1", port))
            await loop.sock_sendall(sock, say(number))


def _silent(size: int, say: Callable[[int], bytes], *, addresses: int = 1, most: int = 2000) -> Strangers:
    async def visit(port: int, stack: AsyncExitStack, first: bool) -> None:
        count = _FEW if first else min((1 << 20) // size, most)
        await _connections(port, stack, count, say, addresses=addresses)

    return visit


def _one_after_the_other(say: Callable[[int], bytes], *, leaves: bool = True) -> Strangers:
    """Requests that are answered; of those who do not leave the answers are not read."""

    async def visit(port: int, stack: AsyncExitStack, first: bool) -> None:
        sent = 0
        for number in range(_FEW if first else 5000):
            data = say(number)
            sent += len(data)
            if sent > 1 << 20:
                return
            reader, writer = await asyncio.open_connection("127.0.0.1", port)
            writer.write(data)
            with contextlib.suppress(ConnectionError):
                await writer.drain()
                if leaves:
                    await reader.read()
            if leaves:
                writer.transport.abort()
            else:
                stack.callback(abort, writer)

    return visit


def _get(path: str, more: str = "") -> bytes:
    return f"GET {path} HTTP/1.1\r\nHost: 127.0.0.1\r\n{more}\r\n".encode()


STRANGERS: Final[dict[str, tuple[str, Strangers]]] = {
    "silent": ("ws", _silent(200, lambda _: b"", addresses=400)),
    "half-heads": ("ws", _silent(16_000, lambda _: b"GET / HTTP/1.1\r\nX: " + b"x" * 16_000, addresses=100)),
    "long-heads": ("ws", _one_after_the_other(lambda _: b"GET / HTTP/1.1\r\nX: " + b"x" * 20_000)),
    "many-headers": ("ws", _one_after_the_other(lambda _: _get("/", "a: b\r\n" * 2000))),
    "bodies": ("ws", _one_after_the_other(lambda _: _get("/", "Content-Length: 100000000\r\n") + b"x" * 60_000)),
    "pages": ("ws", _one_after_the_other(lambda n: _get(("/", "/healthz", "/readyz", f"/nothing{n}")[n % 4]))),
    "long-queries": ("ws", _one_after_the_other(lambda n: _get("/store?" + "&".join(f"a{i}=1" for i in range(2000))))),
    "store-unread": ("ws", _one_after_the_other(lambda n: _get("/store/*/*"), leaves=False)),
    "watchers": ("ws", _silent(60, lambda _: _get("/store?watch=1"), most=1000)),
    "half-open-tls": ("wss", _silent(500, lambda _: _CLIENT_HELLO)),
    "half-open-tls-everywhere": ("wss", _silent(500, lambda _: _CLIENT_HELLO, addresses=400)),
    "unfinished-tls": ("wss", _silent(len(_HELLO), lambda _: _HELLO, addresses=400)),
    "silent-nodes": ("iort", _silent(200, lambda _: b"", addresses=400)),
    "half-packets": ("iort", _silent(1000, lambda n: b"%01/S/t/p/" + b"x" * 990, addresses=400)),
    "resets": ("ws", _one_after_the_other(lambda _: struct.pack("!I", 5) * 50 + b"\r\n\r\n")),
}
"""By their names: the scheme of the listener that they come to, and what they do."""

AT_ROUTERS: Final[dict[str, Strangers]] = {
    "silent": _silent(200, lambda _: b"", addresses=400),
    "half-open-tls": _silent(500, lambda _: _CLIENT_HELLO, addresses=400),
    "unfinished-tls": _silent(len(_HELLO), lambda _: _HELLO, addresses=400),
    "no-tls": _one_after_the_other(lambda _: _get("/") + b"\r\n" * 500),
    "large-records": _one_after_the_other(lambda _: b"\x16\x03\x01\xff\xff" + b"x" * 60_000),
}
"""The same at a router of an overlay, all of whose links are TLS."""
