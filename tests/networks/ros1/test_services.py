"""Services between nodes of ours, beyond what every kind of graph does."""

from __future__ import annotations

import asyncio
import struct

import pytest

from ropeway.errors import CallFailed, TypeConflict
from ropeway.graph.base import Undelivered
from ropeway.graph.calls import Request, ServiceHandler
from ropeway.networks.ros1.service_probe import probe_service
from ropeway.networks.ros1.tcpros import encode_header, read_frame, read_header
from tests.support.services import ADD, addends
from tests.support.until import until

from .conftest import Join

SWITCH = "std_srvs/srv/SetBool"


def adding(more: int) -> ServiceHandler:
    """A handler that adds the two numbers, and ``more``."""

    async def add(request: Request) -> bytes:
        return b"\0\1\0\0" + struct.pack("<q", sum(struct.unpack("<qq", request.payload[4:])) + more)

    return add


async def test_moves(join: Join) -> None:
    """A service that another node takes over is called there, although the first one still answers."""
    first, second, caller = await join("first"), await join("second"), await join("caller")
    await first.create_service("/add", ADD, adding(0))
    client = await caller.create_client("/add", ADD)
    assert await client.call(Request(addends(1, 2))) == b"\0\1\0\0" + struct.pack("<q", 3)
    await until(lambda: [server.node for server in caller.services()["/add"].servers] == ["/first"])
    await second.create_service("/add", ADD, adding(100))
    await until(lambda: [server.node for server in caller.services()["/add"].servers] == ["/second"])
    assert await client.call(Request(addends(1, 2))) == b"\0\1\0\0" + struct.pack("<q", 103)


async def test_connections_are_kept(join: Join) -> None:
    """Calls one after the other use one connection."""
    near, far = await join("near"), await join("far")
    await far.create_service("/add", ADD, adding(0))
    client = await near.create_client("/add", ADD)
    await client.call(Request(addends(1, 2)))
    await until(lambda: near.services()["/add"].servers)
    await client.call(Request(addends(1, 2)))
    streams = list(client._idle)
    for number in range(10):
        await client.call(Request(addends(number, 2)))
    assert client._idle == streams
    assert len(streams) == 1


async def test_wrong_type(join: Join) -> None:
    """A call with another type fails with both sums."""
    near, far = await join("near"), await join("far")
    await far.create_service("/add", ADD, adding(0))
    client = await near.create_client("/add", SWITCH)
    with pytest.raises(CallFailed, match="md5sum"):
        await client.call(Request(b"\0\1\0\0\1"))


async def test_unreadable_response(join: Join) -> None:
    """A handler whose response is none of its type fails the call."""
    near, far = await join("near"), await join("far")

    async def nonsense(request: Request) -> bytes:
        return b"nonsense"

    await far.create_service("/add", ADD, nonsense)
    client = await near.create_client("/add", ADD)
    with pytest.raises(CallFailed, match="AddTwoInts_Response"):
        await client.call(Request(addends(1, 2)))


async def test_second_of_one_node(join: Join) -> None:
    """Of two handlers of one node the first answers, and the second when that has closed."""
    near, far = await join("near"), await join("far")
    first = await far.create_service("/add", ADD, adding(0))
    await far.create_service("/add", ADD, adding(100))
    with pytest.raises(TypeConflict):
        await far.create_service("/add", SWITCH, adding(0))
    client = await near.create_client("/add", ADD)
    assert await client.call(Request(addends(1, 2))) == b"\0\1\0\0" + struct.pack("<q", 3)
    await first.close()
    assert await client.call(Request(addends(1, 2))) == b"\0\1\0\0" + struct.pack("<q", 103)


async def test_probe(join: Join) -> None:
    """The type of a service is told to who asks for it; nobody's is unknown."""
    near, far = await join("near"), await join("far")
    await far.create_service("/add", ADD, adding(0))
    node, other = near._node, far._node
    assert node is not None
    assert other is not None
    assert await probe_service(node, "/add", other.service_api) == "example_interfaces/AddTwoInts"
    for service, api in (("/nobody", other.service_api), ("/add", "rosrpc://127.0.0.1:1"), ("/add", "nonsense")):
        assert await probe_service(node, service, api) == ""


async def test_late_answers(join: Join) -> None:
    """A caller that has left costs its handler the rest of the work, counted; one call needs no second."""
    graph = await join()
    node = graph._node
    assert node is not None
    asked, cancelled = asyncio.Event(), asyncio.Event()

    async def slow(request: Request) -> bytes:
        asked.set()
        try:
            await asyncio.Event().wait()
        finally:
            cancelled.set()
        return b""

    await graph.create_service("/slow", ADD, slow)
    await graph.create_service("/add", ADD, adding(0))

    async def call(service: str) -> tuple[asyncio.StreamReader, asyncio.StreamWriter]:
        reader, writer = await asyncio.open_connection("127.0.0.1", node.port)
        writer.write(encode_header({"callerid": "/raw", "md5sum": "*", "service": service}))
        fields = await read_header(reader)
        assert (fields["type"], fields["request_type"]) == (
            "example_interfaces/AddTwoInts",
            "example_interfaces/AddTwoIntsRequest",
        )
        writer.write(struct.pack("<Iqq", 16, 1, 2))
        return reader, writer

    reader, writer = await call("/add")
    assert await reader.readexactly(1) == b"\1"
    assert await read_frame(reader) == struct.pack("<q", 3)
    assert await reader.read() == b""
    writer.close()
    _, writer = await call("/slow")
    await asked.wait()
    writer.close()
    await cancelled.wait()
    assert graph.drops["/slow", Undelivered.LATE] == 1
