"""What goes wrong on a ROS 1 network, and what is left standing."""

from __future__ import annotations

import asyncio
import contextlib
import struct

import pytest

from ropeway import aio
from ropeway.errors import GraphUnavailable
from ropeway.graph.base import Undelivered
from ropeway.graph.calls import Request
from ropeway.limits import ROS1_NEWCOMERS, ROS1_PUBLISHERS_PER_TOPIC
from ropeway.networks.ros1 import Ros1Graph
from ropeway.networks.ros1.tcpros import encode_header
from ropeway.networks.ros1.xmlrpc import split_uri
from ropeway.qos import LATCHED, QoS
from tests.support.ports import free_port
from tests.support.services import ADD
from tests.support.until import PATIENCE_S, until

from .conftest import Join
from .messages import STRING, Box, sample, text
from .network import RosMaster


async def add(request: Request) -> bytes:
    return b"\0\1\0\0" + struct.pack("<q", sum(struct.unpack("<qq", request.payload[4:])))


async def test_no_master() -> None:
    """A graph whose master does not answer says what to start."""
    with pytest.raises(GraphUnavailable, match="start roscore"):
        await Ros1Graph(f"http://127.0.0.1:{free_port()}").open()


async def test_master_restarts(master: RosMaster, join: Join) -> None:
    """With the master away topics flow on; when it is back everything is found again, also what came meanwhile."""
    near, far = await join("near"), await join("far")
    box, late = Box(), Box()
    subscription = await far.create_subscription("/chatter", STRING, QoS(), box)
    publisher = await near.create_publisher("/chatter", STRING)
    await near.create_service("/add", ADD, add)
    await until(lambda: publisher.subscribers == 1 and subscription._reader.links)
    connection = subscription._reader.links[0]
    master.kill()
    await until(lambda: not near.up and not far.up)
    publisher.publish(sample(text("alone")))
    await until(lambda: box.texts == ["alone"])
    other = await near.create_publisher("/other", STRING, LATCHED)
    other.publish(sample(text("meanwhile")))
    await far.create_subscription("/other", STRING, None, late)
    master.start()
    await until(lambda: near.up and far.up)
    await until(lambda: late.texts == ["meanwhile"])
    await until(lambda: {"/chatter", "/other"} <= far.topics().keys() and "/add" in far.services())
    client = await far.create_client("/add", ADD)
    assert await client.call(Request(b"\0\1\0\0" + struct.pack("<qq", 1, 2)), 10) == b"\0\1\0\0" + struct.pack("<q", 3)
    publisher.publish(sample(text("together")))
    await until(lambda: box.texts == ["alone", "together"])
    assert subscription._reader.links == [connection]


async def test_closes_without_master(master: RosMaster, join: Join) -> None:
    """A graph closes soon although its master is gone."""
    graph = await join()
    for number in range(3):
        await graph.create_publisher(f"/t{number}", STRING)
    master.kill()
    async with aio.timeout(PATIENCE_S):
        await graph.close()


async def test_stalled_reader(master: RosMaster, join: Join) -> None:
    """A subscriber that does not read loses the oldest messages, counted; the others get everything."""
    near, far = await join("near"), await join("far")
    box = Box()
    await far.create_subscription("/chatter", STRING, QoS(), box)
    publisher = await near.create_publisher("/chatter", STRING, QoS(depth=5))
    node = near._node
    assert node is not None
    _, writer = await asyncio.open_connection("127.0.0.1", node.port, limit=1)
    header = {"callerid": "/stalled", "md5sum": "*", "topic": "/chatter", "type": "*"}
    writer.write(encode_header(header))
    await until(lambda: publisher.subscribers == 2)
    big = "x" * 1_000_000
    for number in range(60):
        publisher.publish(sample(text(f"{number} {big}")))
        await until(lambda number=number: len(box.samples) == number + 1)
    assert near.drops["/chatter", Undelivered.WRITE] >= 30
    assert not far.drops
    writer.close()
    await until(lambda: publisher.subscribers == 1)


HOSTILE = (
    b"",
    b"\0" * 3,
    b"\xff" * 64,
    struct.pack("<I", 2**31) + b"x" * 100,
    struct.pack("<I", 0),
    struct.pack("<II", 8, 2**32 - 1) + b"abcd",
    struct.pack("<II", 8, 4) + b"abcd",
    encode_header({"topic": "/nothing", "md5sum": "*", "callerid": "/x"}),
    encode_header({"topic": "/chatter", "md5sum": "0" * 32, "type": "std_msgs/Int8", "callerid": "/x"}),
    encode_header({"service": "/add", "md5sum": "0" * 32}),
    encode_header({"service": "/add", "md5sum": "*"}) + struct.pack("<I", 3) + b"abc",
    encode_header({"service": "/add", "md5sum": "*", "persistent": "1"}) + struct.pack("<I", 2**32 - 1),
    encode_header({"service": "/add", "md5sum": "*", "persistent": "1"}) + struct.pack("<I", 0) * 1000,
    encode_header({f"field{n}": "x" for n in range(1000)}),
    b"GET / HTTP/1.1\r\n\r\n",
    b"POST / HTTP/1.1\r\n\r\n",
    b"POST / HTTP/1.1\r\nContent-Length: 99999999999\r\n\r\n",
    b"POST / HTTP/1.1\r\nContent-Length: -5\r\n\r\n",
    b"POST / HTTP/1.1\r\nContent-Length: 5\r\n\r\nhello",
    b"POST / HTTP/1.1\r\n" + b"A: b\r\n" * 500 + b"\r\n",
    b"POST / HTTP/1.1\r\n" + b"A" * 100_000,
    b"POST / HTTP/1.1\r\nContent-Length: 90\r\n\r\n"
    + b'<!DOCTYPE x [<!ENTITY a "b">]><methodCall><methodName>getPid</methodName></methodCall>'.ljust(90),
)


async def attack(port: int, data: bytes) -> bytes:
    """What a port answers to ``data``, all of it until the connection is closed from there."""
    reader, writer = await asyncio.open_connection("127.0.0.1", port)
    answer = b""
    with contextlib.suppress(ConnectionError):
        writer.write(data)
        writer.write_eof()
        async with aio.timeout(PATIENCE_S):
            answer = await reader.read()
    writer.close()
    return answer


async def test_hostile_bytes(master: RosMaster, join: Join) -> None:
    """Whatever comes to its ports, a node answers with an error or closes, and goes on as before."""
    near, far = await join("near"), await join("far")
    box = Box()
    await far.create_subscription("/chatter", STRING, QoS(), box)
    publisher = await near.create_publisher("/chatter", STRING)
    await near.create_service("/add", ADD, add)
    await until(lambda: publisher.subscribers == 1)
    node = near._node
    assert node is not None
    for data in HOSTILE:
        for port in (node.port, split_uri(node.uri)[1]):
            answer = await attack(port, data)
            assert not answer or b"error" in answer or b"HTTP/1.1 " in answer or b"callerid" in answer, (data, answer)
    publisher.publish(sample(text("still here")))
    await until(lambda: box.texts == ["still here"])
    client = await far.create_client("/add", ADD)
    assert await client.call(Request(b"\0\1\0\0" + struct.pack("<qq", 1, 2)), 10)
    assert publisher.subscribers == 1


async def test_hostile_publisher(master: RosMaster, join: Join) -> None:
    """A publisher that sends bytes of another type, or no TCPROS at all, costs nobody else anything."""
    near, far = await join("near"), await join("far")
    box = Box()
    await near.create_subscription("/chatter", STRING, QoS(), box)
    publisher = await far.create_publisher("/chatter", STRING)
    await until(lambda: publisher.subscribers == 1)
    publisher.publish_raw(b"\xff\xff\xff\xff")
    await until(lambda: near.drops["/chatter", Undelivered.DECODE] == 1)
    connection = publisher.writer.links[0].connection
    connection.write((b"\xff" * 64,))
    await until(lambda: publisher.subscribers == 1 and publisher.writer.links[0].connection is not connection)
    publisher.publish(sample(text("sound")))
    await until(lambda: box.texts == ["sound"])


async def test_more_publishers_than_are_read(master: RosMaster, join: Join) -> None:
    """Told of thousands of publishers that are none, a node tries a bounded number, and those it reads stay."""
    near, far = await join("near"), await join("far")
    box = Box()
    subscription = await near.create_subscription("/chatter", STRING, QoS(), box)
    publisher = await far.create_publisher("/chatter", STRING)
    await until(lambda: publisher.subscribers == 1)
    reader = subscription._reader
    (real,) = reader.uris
    reader.update([*(f"http://127.0.0.1:{port}/" for port in range(1, 5000)), real])
    assert len(reader.uris) == ROS1_PUBLISHERS_PER_TOPIC
    assert real in reader.uris
    publisher.publish(sample(text("still here")))
    await until(lambda: box.texts == ["still here"])
    reader.update([real])
    assert reader.uris == {real}


async def test_silent_newcomers(master: RosMaster, join: Join) -> None:
    """Whoever connects to a node and says nothing keeps nobody out: the oldest makes room."""
    near, far = await join("near"), await join("far")
    assert near._node is not None
    silent = [await asyncio.open_connection("127.0.0.1", near._node.port) for _ in range(ROS1_NEWCOMERS + 1)]
    with contextlib.suppress(ConnectionResetError):
        assert await silent[0][0].read() == b""
    box = Box()
    await far.create_subscription("/chatter", STRING, QoS(), box)
    publisher = await near.create_publisher("/chatter", STRING, LATCHED)
    publisher.publish(sample(text("there is room")))
    await until(lambda: box.texts == ["there is room"])
    for _, writer in silent:
        writer.close()


async def test_same_name(master: RosMaster, join: Join) -> None:
    """A node whose name a living node has takes another one, and both go on."""
    first = await join("twin")
    publisher = await first.create_publisher("/chatter", STRING)
    second = await join("twin")
    assert first.node == "/twin"
    assert second.node.startswith("/twin_")
    box = Box()
    await second.create_subscription("/chatter", STRING, QoS(), box)
    await until(lambda: publisher.subscribers == 1)
    publisher.publish(sample(text("brother")))
    await until(lambda: box.texts == ["brother"])


async def test_name_taken_over(master: RosMaster, join: Join) -> None:
    """A node whose name another one takes while it runs goes on under a new name."""
    first, other = await join("twin"), await join("other")
    publisher = await first.create_publisher("/chatter", STRING)
    node = other._node
    assert node is not None
    node.name = node.master.caller = "/twin"
    await other.create_publisher("/mine", STRING)
    await until(lambda: first.node.startswith("/twin_"))
    await until(lambda: "/chatter" in other.topics() and other.topics()["/chatter"].publishers[0].node == first.node)
    assert not publisher.closed


async def test_silent_newcomer(master: RosMaster, join: Join, monkeypatch: pytest.MonkeyPatch) -> None:
    """Who connects and says nothing is turned away."""
    monkeypatch.setattr("ropeway.networks.ros1.node._HEADER_S", 0.05)
    graph = await join()
    node = graph._node
    assert node is not None
    reader, writer = await asyncio.open_connection("127.0.0.1", node.port)
    async with aio.timeout(PATIENCE_S):
        with contextlib.suppress(ConnectionError):
            assert await reader.read() == b""
    writer.close()
