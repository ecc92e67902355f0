"""XML-RPC over HTTP."""

from __future__ import annotations

import asyncio
import threading
import tracemalloc
from collections.abc import AsyncIterator, Awaitable, Callable
from contextlib import AsyncExitStack
from typing import Any
from xmlrpc.client import ServerProxy, dumps, loads
from xmlrpc.server import SimpleXMLRPCServer

import pytest

from ropeway.errors import ConnectFailed
from ropeway.limits import ROS1_CALLERS
from ropeway.networks.ros1.xmlrpc import Fault, XmlRpcClient, XmlRpcServer, split_uri
from tests.support.ports import free_port

Serve = Callable[[Callable[..., Awaitable[Any]]], Awaitable[str]]


@pytest.fixture
async def client() -> AsyncIterator[XmlRpcClient]:
    made = XmlRpcClient()
    yield made
    await made.close()


@pytest.fixture
async def serve() -> AsyncIterator[Serve]:
    """Starts servers; gives their URIs."""
    async with AsyncExitStack() as stack:

        async def started(handler: Callable[..., Awaitable[Any]]) -> str:
            server = XmlRpcServer(handler)
            await server.open("127.0.0.1")
            stack.push_async_callback(server.close)
            return f"http://127.0.0.1:{server.port}/"

        yield started


async def echo(method: str, params: tuple[Any, ...]) -> Any:
    if method == "fail":
        raise Fault(7, "on purpose")
    if method == "break":
        raise RuntimeError("not on purpose")
    return [method, *params]


async def raw(answer: bytes) -> tuple[asyncio.Server, str]:
    """A server that answers anything with these bytes and closes."""

    async def talk(reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        await reader.readuntil(b"\r\n\r\n")
        writer.write(answer)
        await writer.drain()
        writer.close()

    server = await asyncio.start_server(talk, "127.0.0.1", 0)
    return server, f"http://127.0.0.1:{server.sockets[0].getsockname()[1]}/"


async def test_call(client: XmlRpcClient, serve: Serve) -> None:
    """A method gets its parameters, whatever is in them, and its value comes back."""
    uri = await serve(echo)
    for params in ((), (1, "zwei ü <&>", 3.5, True), ([1, [2]], {"a": {"b": ""}})):
        assert await client.call(uri, "method", *params) == ["method", *params]


async def test_keeps_alive(client: XmlRpcClient, serve: Serve) -> None:
    """Calls one after the other use one connection; calls at a time have one each."""
    uri = await serve(echo)
    for _ in range(3):
        await client.call(uri, "x")
    assert [len(kept) for kept in client._idle.values()] == [1]
    await asyncio.gather(*(client.call(uri, "x") for _ in range(20)))
    assert [len(kept) for kept in client._idle.values()] == [4]


async def test_server_restarts(client: XmlRpcClient) -> None:
    """A connection that was closed while idle is made again."""
    port = free_port()
    for _ in range(2):
        server = XmlRpcServer(echo)
        await server.open("127.0.0.1", port)
        assert await client.call(f"http://127.0.0.1:{port}/", "x") == ["x"]
        await server.close()


async def test_faults(client: XmlRpcClient, serve: Serve) -> None:
    """What a handler raises goes to the caller as a fault."""
    uri = await serve(echo)
    with pytest.raises(Fault, match="on purpose"):
        await client.call(uri, "fail")
    with pytest.raises(Fault, match="RuntimeError: not on purpose"):
        await client.call(uri, "break")


async def test_other_client(serve: Serve) -> None:
    """The client of Python's library is answered."""
    uri = await serve(echo)

    def call() -> Any:
        with ServerProxy(uri) as proxy:
            return proxy.hello(1, "two")

    assert await asyncio.to_thread(call) == ["hello", 1, "two"]


async def test_other_server(client: XmlRpcClient) -> None:
    """The server of Python's library, which speaks HTTP/1.0, is called."""
    with SimpleXMLRPCServer(("127.0.0.1", 0), logRequests=False) as server:
        server.register_function(lambda a, b: a + b, "add")
        thread = threading.Thread(target=server.serve_forever)
        thread.start()
        try:
            uri = f"http://127.0.0.1:{server.server_address[1]}/"
            assert [await client.call(uri, "add", 1, n) for n in range(3)] == [1, 2, 3]
        finally:
            await asyncio.to_thread(server.shutdown)
            thread.join()


@pytest.mark.parametrize(
    "answer",
    [
        b"",
        b"garbage\r\n\r\n",
        b"HTTP/1.1 404 Not Found\r\nContent-Length: 0\r\n\r\n",
        b"HTTP/1.1 200 OK\r\nContent-Length: 5\r\n\r\nhello",
        b"HTTP/1.1 200 OK\r\nContent-Length: 500\r\n\r\nhello",
        b"HTTP/1.1 200 OK\r\nContent-Length: 99999999999\r\n\r\n",
        b"HTTP/1.1 200 OK\r\n\r\n<methodResponse/>",
        b"HTTP/1.1 200 OK\r\n\r\n<!DOCTYPE x><methodResponse/>",
        b"HTTP/1.1 200 OK\r\n\r\n" + '<?xml encoding="utf-16"?><!DOCTYPE x><methodResponse/>'.encode("utf-16"),
        b"HTTP/1.1 200 OK\r\n\r\n" + '<?xml version="1.0"?><!DOCTYPE x><methodResponse/>'.encode("utf-16-be"),
        b"HTTP/1.1 200 OK\r\n" + b"a: b\r\n" * 100 + b"\r\n",
    ],
)
async def test_bad_answers(client: XmlRpcClient, answer: bytes) -> None:
    """An answer that is none fails the call with the address."""
    server, uri = await raw(answer)
    with pytest.raises(ConnectFailed, match=r"127\.0\.0\.1"):
        await client.call(uri, "x")
    server.close()


@pytest.mark.parametrize(
    ("body", "text"),
    [
        ("<methodResponse><fault><value><int>1</int></value></fault></methodResponse>", "not XML-RPC"),
        (dumps(Fault(1, "x"), methodresponse=True), "a fault is not a call"),
        ("<methodResponse><params/></methodResponse>", "no method is named"),
        (f"<methodCall>{'<value><array><data>' * 50_000}", "stand in each other"),
        (f"<methodCall>{'<value>' * 100_000}", "stand in each other"),
        (f"<methodCall>{''.join(f'<a{i}/>' for i in range(100_000))}", "has no element 'a0'"),
        (f"<methodCall {' '.join(f'a{i}=' + chr(34) * 2 for i in range(90_000))}>", "so much in their tags"),
        (f"<!-- x --><methodCall {'a' * 100}=''>", "so much in their tags"),
    ],
)
async def test_bad_calls(serve: Serve, body: str, text: str, caplog: pytest.LogCaptureFixture) -> None:
    """A call that is none is answered with what is wrong with it, costs next to nothing, and is no failure of ours."""
    host, port = split_uri(await serve(echo))
    reader, writer = await asyncio.open_connection(host, port)
    tracemalloc.start()
    writer.write(f"POST / HTTP/1.1\r\nContent-Length: {len(body)}\r\n\r\n{body}".encode())
    answer = (await reader.read()).decode()
    held_most = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    writer.close()
    assert answer.startswith("HTTP/1.1 400 ")
    assert text in answer
    assert held_most < 8 << 20
    assert not caplog.records


async def test_silent_callers(serve: Serve) -> None:
    """Whoever connects and says nothing keeps nobody out: the one that has been silent longest makes room."""
    host, port = split_uri(await serve(echo))
    silent = [await asyncio.open_connection(host, port) for _ in range(ROS1_CALLERS)]
    client = XmlRpcClient()
    for _ in range(3):
        assert await client.call(f"http://{host}:{port}/", "x") == ["x"]
    await client.close()
    assert await silent[0][0].read() == b""
    late = [await asyncio.open_connection(host, port) for _ in range(ROS1_CALLERS)]
    assert [await reader.read() for reader, _ in silent] == [b""] * ROS1_CALLERS
    for _, writer in (*silent, *late):
        writer.close()


async def test_a_web_page(serve: Serve) -> None:
    """A call of a page in a browser, which says where the page is from, is refused."""
    called: list[str] = []

    async def note(method: str, _: object) -> int:
        called.append(method)
        return 1

    host, port = split_uri(await serve(note))
    body = dumps(("/page",), "shutdown")
    reader, writer = await asyncio.open_connection(host, port)
    head = f"POST / HTTP/1.1\r\nOrigin: http://evil.example\r\nContent-Length: {len(body)}\r\n\r\n"
    writer.write((head + body).encode())
    answer = await reader.read()
    writer.close()
    assert answer.startswith(b"HTTP/1.1 400 ")
    assert b"web pages may not call nodes" in answer
    assert called == []


async def test_texts_that_look_like_elements(serve: Serve) -> None:
    """In a text that says so, anything may stand, however long the elements in it are."""
    text = f"<link name={'x' * 100!r}/>"
    body = dumps(("x",), "a").replace("<string>x</string>", f"<![CDATA[{text}]]>")
    host, port = split_uri(await serve(echo))
    reader, writer = await asyncio.open_connection(host, port)
    writer.write(f"POST / HTTP/1.0\r\nContent-Length: {len(body)}\r\n\r\n{body}".encode())
    answer = await reader.read()
    writer.close()
    assert loads(answer.partition(b"\r\n\r\n")[2])[0] == (["a", text],)


async def test_answer_without_length(client: XmlRpcClient) -> None:
    """An answer that ends with its connection is taken."""
    body = "<methodResponse><params><param><value><int>5</int></value></param></params></methodResponse>"
    server, uri = await raw(f"HTTP/1.0 200 OK\r\n\r\n{body}".encode())
    assert await client.call(uri, "x") == 5
    server.close()


async def test_no_answer(client: XmlRpcClient, serve: Serve) -> None:
    """A call that nobody answers, or not in time, fails."""

    async def never(method: str, params: tuple[Any, ...]) -> None:
        await asyncio.Event().wait()

    with pytest.raises(ConnectFailed):
        await client.call(f"http://127.0.0.1:{free_port()}/", "x")
    with pytest.raises(ConnectFailed, match=r"within 0\.05 s"):
        await client.call(await serve(never), "x", timeout_s=0.05)


async def test_unwritable(client: XmlRpcClient) -> None:
    """What XML-RPC has no form for is refused before anything is sent."""
    for value in (2**40, object()):
        with pytest.raises(ValueError, match="XML-RPC"):
            await client.call("http://127.0.0.1:1/", "x", value)


def test_uris() -> None:
    """Only http addresses with a port are taken."""
    assert split_uri("http://robot:11311/") == ("robot", 11311)
    for bad in ("robot:11311", "https://robot:1", "http://robot", "http://:1", "http://robot:x"):
        with pytest.raises(ValueError, match=r"http://host:port|[Pp]ort"):
            split_uri(bad)
