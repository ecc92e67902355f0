"""XML-RPC over HTTP on asyncio: just what ROS 1's master and nodes speak.

Connections are kept alive where the peer allows it. Bodies, header lines and waits are bounded on both sides.
"""

from __future__ import annotations

import asyncio
import contextlib
import logging
import re
import xmlrpc.client  # bodies are bounded, and read by ``_Reader``
from collections.abc import Awaitable, Callable, Sequence
from typing import Any, Final
from urllib.parse import urlsplit

from ropeway import aio
from ropeway.errors import ConnectFailed
from ropeway.limits import NESTED_CONTAINERS, ROS1_CALLERS
from ropeway.tasks import describe, end

__all__ = ["Fault", "XmlRpcClient", "XmlRpcServer", "close_streams", "split_uri", "stop_listening"]

log = logging.getLogger("ropeway.ros1")

Handler = Callable[[str, tuple[Any, ...]], Awaitable[Any]]
"""Answers a method and its parameters; a ``Fault`` it raises goes to the caller."""

Fault = xmlrpc.client.Fault
"""A server's answer instead of a value: ``faultCode`` and ``faultString``."""

_CALL_S: Final = 5.0
_CLOSE_S: Final = 1.0
_ACCEPT_TURNS: Final = 4  # of the loop: a connection is accepted, made, told of, and closed if it is not wanted
_IDLE_S: Final = 60.0  # a connection without a request for so long is closed
_ANSWER_LIMIT_BYTES: Final = 64 << 20  # a parameter may hold a robot's whole description
_REQUEST_LIMIT_BYTES: Final = 1 << 20  # what nodes are told fits in a few hundred bytes
_LINE_LIMIT_BYTES: Final = 1 << 16
_HEADERS_LIMIT: Final = 64
_IDLE_LIMIT: Final = 4  # connections kept per peer
_PEERS_LIMIT: Final = 256
_STRUCTURE: Final = ("methodCall", "methodName", "methodResponse", "params", "param", "fault", "value")
_CONTAINERS: Final = ("array", "data", "struct", "member", "name")
_NUMBERS: Final = ("boolean", "int", "i1", "i2", "i4", "i8", "biginteger", "double", "float", "bigdecimal")
_OTHERS: Final = ("nil", "string", "base64", "dateTime.iso8601")
_ELEMENTS: Final = frozenset((*_STRUCTURE, *_CONTAINERS, *_NUMBERS, *_OTHERS))
_LONG_TAG: Final = re.compile(rb"<[^!?>][^>]{64}")  # attributes, or a name, that XML-RPC does not have
_ASIDE: Final = re.compile(rb"<!\[CDATA\[.*?\]\]>|<!--.*?-->", re.DOTALL)  # what may have a "<" that is no tag
_DEPTH_LIMIT: Final = 3 * NESTED_CONTAINERS + 8  # a list in a list is a value, an array and its data


class _Malformed(Exception):
    """Raised for text that is not HTTP, or not XML-RPC."""


Stream = tuple[asyncio.StreamReader, asyncio.StreamWriter]


async def stop_listening(server: asyncio.Server) -> None:
    """Listen no more. Whoever is being accepted is told of first: asyncio leaves those open whose server is closed."""
    loop = asyncio.get_running_loop()
    for listening in server.sockets:
        loop.remove_reader(listening)
    for _ in range(_ACCEPT_TURNS):
        await asyncio.sleep(0)
    server.close()


async def close_streams(writers: Sequence[asyncio.StreamWriter]) -> None:
    """Close streams, and wait a moment until they are."""
    for writer in writers:
        writer.close()
    with contextlib.suppress(TimeoutError):
        async with aio.timeout(_CLOSE_S):
            for writer in writers:
                with contextlib.suppress(OSError):
                    await writer.wait_closed()


def split_uri(uri: str) -> tuple[str, int]:
    """Return host and port of ``http://host:port/``. Raises ``ValueError``."""
    parts = urlsplit(uri)
    if parts.scheme != "http" or not parts.hostname or parts.port is None:
        raise ValueError(f"expected http://host:port, got {uri!r}")
    return parts.hostname, parts.port


class XmlRpcClient:
    """Calls methods of servers; any number at a time, each over a connection of its own while it lasts."""

    def __init__(self) -> None:
        self._idle: dict[tuple[str, int], list[Stream]] = {}
        self._closed = False

    async def call(self, uri: str, method: str, *params: Any, timeout_s: float = _CALL_S) -> Any:
        """Call ``method`` of the server at ``uri`` and return its answer.

        Raises ``ConnectFailed`` if there is no answer in time or none that can be understood, ``Fault`` where the
        server raised one, ``ValueError`` for parameters that XML-RPC cannot write.
        """
        try:
            body = xmlrpc.client.dumps(params, method, allow_none=True).encode()
        except (TypeError, OverflowError) as error:
            raise ValueError(f"cannot be written as XML-RPC: {error}") from None
        try:
            address = split_uri(uri)
            async with aio.timeout(timeout_s):
                answer = await self._exchange(address, uri, body)
        except TimeoutError:
            raise ConnectFailed(uri, f"no answer to {method} within {timeout_s:g} s") from None
        except (OSError, EOFError, ValueError, _Malformed) as error:
            raise ConnectFailed(uri, f"{method} failed: {error or type(error).__name__}") from None
        try:
            return _loads(answer)[0][0]
        except (_Malformed, IndexError) as error:
            raise ConnectFailed(uri, f"the answer to {method} cannot be understood: {error}") from None

    async def _exchange(self, address: tuple[str, int], uri: str, body: bytes) -> bytes:
        host, port = address
        named = f"[{host}]" if ":" in host else host
        head = (
            f"POST {urlsplit(uri).path or '/'} HTTP/1.1\r\nHost: {named}:{port}\r\nUser-Agent: ropeway\r\n"
            f"Content-Type: text/xml\r\nContent-Length: {len(body)}\r\n\r\n"
        )
        request = head.encode("ascii") + body
        kept = self._idle.get(address, [])
        while kept:
            stream = kept.pop()
            try:
                return await self._send(address, stream, request)
            except (OSError, EOFError):
                continue  # it was closed while idle, before it could read the request
        stream = await asyncio.open_connection(host, port, limit=_LINE_LIMIT_BYTES)
        return await self._send(address, stream, request)

    async def _send(self, address: tuple[str, int], stream: Stream, request: bytes) -> bytes:
        reader, writer = stream
        keep = False
        try:
            writer.write(request)
            await writer.drain()
            line = await reader.readline()
            if not line:
                raise EOFError("the connection was closed")
            version, _, status = line.decode("latin-1").partition(" ")
            headers = await _read_headers(reader)
            answer = await _read_body(reader, headers, _ANSWER_LIMIT_BYTES, whole=True)
            if not status.startswith("200"):
                raise _Malformed(f"HTTP status {status.strip()}")
            keep = _keeps_alive(version, headers) and "content-length" in headers
        finally:
            kept = self._idle.setdefault(address, []) if keep and not self._closed else None
            if kept is not None and len(kept) < _IDLE_LIMIT and len(self._idle) <= _PEERS_LIMIT:
                kept.append(stream)
            else:
                writer.close()
        return answer

    async def close(self) -> None:
        """Close the connections that are kept."""
        self._closed = True
        streams = [stream for kept in self._idle.values() for stream in kept]
        self._idle.clear()
        await close_streams([writer for _, writer in streams])


class XmlRpcServer:
    """Answers calls on one port with ``handler``."""

    def __init__(self, handler: Handler) -> None:
        self._handler = handler
        self._server: asyncio.Server | None = None
        self._tasks: dict[asyncio.Task[None], asyncio.StreamWriter] = {}
        self._idle: dict[asyncio.Task[None], None] = {}  # those that wait for a request, the longest first
        self.port = 0

    async def open(self, host: str, port: int = 0) -> None:
        """Listen at ``host``; ``self.port`` tells where. Raises ``OSError``."""
        self._server = await asyncio.start_server(self._accepted, host, port, limit=_LINE_LIMIT_BYTES)
        self.port = self._server.sockets[0].getsockname()[1]

    async def close(self) -> None:
        """Stop answering."""
        server, self._server = self._server, None
        if server is not None:
            await stop_listening(server)
        writers = list(self._tasks.values())
        await end(*self._tasks)
        await close_streams(writers)

    def _accepted(self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        if self._server is None or not self._has_room():
            writer.close()
            return
        task = asyncio.create_task(self._serve(reader, writer), name="XML-RPC connection")
        self._tasks[task] = writer
        task.add_done_callback(self._ended)

    def _has_room(self) -> bool:
        """Return whether another client may connect, if need be in the place of the one that has been silent
        longest.
        """
        if len(self._tasks) < ROS1_CALLERS:
            return True
        if (silent := next(iter(self._idle), None)) is None:
            return False
        del self._idle[silent]
        silent.cancel()
        return True

    def _ended(self, task: asyncio.Task[None]) -> None:
        self._tasks.pop(task).close()
        self._idle.pop(task, None)
        if not task.cancelled() and (error := task.exception()) is not None:
            log.error("an XML-RPC connection failed: %s", describe(error), exc_info=error)

    async def _serve(self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        task = asyncio.current_task()
        assert task is not None
        try:
            while True:
                self._idle[task] = None
                async with aio.timeout(_IDLE_S):
                    line = await reader.readline()
                self._idle.pop(task, None)
                if not line or not await self._answer(line, reader, writer):
                    return
        except (OSError, EOFError, ValueError, TimeoutError):
            return  # the peer has gone, sends nothing or too long a line; there is nobody to tell
        except _Malformed as error:
            with contextlib.suppress(OSError, TimeoutError):
                await _respond(writer, "400 Bad Request", str(error).encode(), "text/plain", False)

    async def _answer(self, line: bytes, reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> bool:
        """Answer one request; true if another may follow on this connection."""
        words = line.decode("latin-1").split()
        if len(words) != 3 or not words[2].startswith("HTTP/1."):
            raise _Malformed("not an HTTP request")
        if words[0] != "POST":
            await _respond(writer, "501 Unsupported method", b"only POST is known here", "text/plain", False)
            return False
        async with aio.timeout(_CALL_S):
            headers = await _read_headers(reader)
            if "origin" in headers:  # a browser sends for whatever page is open in it
                raise _Malformed("web pages may not call nodes")
            if headers.get("expect", "").lower() == "100-continue":
                writer.write(b"HTTP/1.1 100 Continue\r\n\r\n")
            request = await _read_body(reader, headers, _REQUEST_LIMIT_BYTES, whole=False)
        try:
            params, method = _loads(request)
        except Fault:
            raise _Malformed("a fault is not a call") from None
        if method is None:
            raise _Malformed("no method is named")
        try:
            answer = xmlrpc.client.dumps((await self._handler(method, params),), methodresponse=True, allow_none=True)
        except Fault as fault:
            answer = xmlrpc.client.dumps(fault, methodresponse=True)
        except Exception as error:  # whatever a caller's parameters did to the handler is the caller's to know
            log.exception("answering %s failed", method)
            answer = xmlrpc.client.dumps(Fault(1, f"{type(error).__name__}: {error}"), methodresponse=True)
        keep = _keeps_alive(words[2], headers)
        await _respond(writer, "200 OK", answer.encode(), "text/xml", keep)
        return keep


async def _respond(writer: asyncio.StreamWriter, status: str, body: bytes, kind: str, keep: bool) -> None:
    head = (
        f"HTTP/1.1 {status}\r\nServer: ropeway\r\nContent-Type: {kind}\r\nContent-Length: {len(body)}\r\n"
        f"Connection: {'keep-alive' if keep else 'close'}\r\n\r\n"
    )
    writer.write(head.encode("ascii") + body)
    async with aio.timeout(_CALL_S):
        await writer.drain()


async def _read_headers(reader: asyncio.StreamReader) -> dict[str, str]:
    headers: dict[str, str] = {}
    for _ in range(_HEADERS_LIMIT):
        line = await reader.readline()
        if not line:
            raise EOFError("the connection was closed")
        text = line.decode("latin-1").strip()
        if not text:
            return headers
        name, _, value = text.partition(":")
        headers[name.strip().lower()] = value.strip()
    raise _Malformed(f"more than {_HEADERS_LIMIT} header lines")


async def _read_body(reader: asyncio.StreamReader, headers: dict[str, str], limit: int, *, whole: bool) -> bytes:
    """Read the body of a message; ``whole`` allows one that ends with the connection."""
    length = headers.get("content-length")
    if length is None:
        if not whole or "transfer-encoding" in headers:
            raise _Malformed("a body without Content-Length is not understood")
        pieces, size = [], 0
        while piece := await reader.read(1 << 16):
            pieces.append(piece)
            size += len(piece)
            if size > limit:
                raise _Malformed(f"a body above {limit} bytes")
        return b"".join(pieces)
    if not length.isascii() or not length.isdigit() or len(length) > 12 or int(length) > limit:
        raise _Malformed(f"a body of {length[:12]} bytes; the limit is {limit}")
    return await reader.readexactly(int(length))


def _keeps_alive(version: str, headers: dict[str, str]) -> bool:
    connection = headers.get("connection", "").lower()
    return "keep-alive" in connection if version == "HTTP/1.0" else "close" not in connection


class _Reader(xmlrpc.client.Unmarshaller):
    """Refuses elements that XML-RPC does not have and what is nested too deeply, before they cost anything."""

    def __init__(self) -> None:
        super().__init__()
        self._depth = 0

    def start(self, tag: str, attrs: dict[str, str]) -> None:
        """Begin an element; see ``Unmarshaller``."""
        self._depth += 1
        if self._depth > _DEPTH_LIMIT:
            raise _Malformed(f"elements stand in each other {_DEPTH_LIMIT} deep")
        if tag.removeprefix("ex:") not in _ELEMENTS:
            raise _Malformed(f"XML-RPC has no element {tag!r:.40}")
        super().start(tag, attrs)

    def end(self, tag: str) -> None:
        """End an element; see ``Unmarshaller``."""
        self._depth -= 1
        super().end(tag)


def _loads(body: bytes) -> tuple[tuple[Any, ...], str | None]:
    """Parse the parameters and the method of an XML-RPC body.

    Raises ``_Malformed``; ``Fault`` where the body is one.
    """
    if b"\0" in body:  # UTF-16, in which what follows could not be found
        raise _Malformed("XML-RPC is written in UTF-8")
    if b"<!DOCTYPE" in body or b"<!ENTITY" in body:
        raise _Malformed("XML-RPC has no document types")
    if _LONG_TAG.search(_ASIDE.sub(b"", body) if b"<!" in body else body):
        raise _Malformed("XML-RPC has no elements with so much in their tags")
    reader = _Reader()
    parser = xmlrpc.client.ExpatParser(reader)
    try:
        parser.feed(body)
        parser.close()
        return reader.close(), reader.getmethodname()
    except (Fault, _Malformed):
        raise
    except Exception as error:  # the parser fails in many ways on what is no XML-RPC
        raise _Malformed(f"not XML-RPC: {error or type(error).__name__}") from None
