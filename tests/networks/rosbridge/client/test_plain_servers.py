"""ropeway.networks.rosbridge.client.plain_servers: what servers that are no Ropeway gateways are sent."""

from __future__ import annotations

import asyncio
import base64
import hashlib
import json
import logging
import time
from collections.abc import AsyncIterator, Awaitable, Callable
from contextlib import AsyncExitStack
from typing import Any

import cbor2
import pytest

from ropeway.graph.base import SEQ_NONE, Delivery, Sample
from ropeway.networks.rosbridge.client import RosbridgeGraph
from ropeway.networks.rosbridge.client.plain_servers import rosgw_reads
from ropeway.qos import LATCHED
from ropeway.types import TypeRegistry
from tests.support.until import until

pytestmark = pytest.mark.jumping

STRING, JOINTS = "std_msgs/msg/String", "sensor_msgs/msg/JointState"
TORNADO, ROSGW, UNKNOWN = "Server: TornadoServer/6.4", "date: Sun, 22 Nov 2026 10:05:03 GMT", "Server: nginx"
REGISTRY = TypeRegistry()
_GUID = b"258EAFA5-E914-47DA-95CA-C5AB0DC85B11"


class FakeServer:
    """Answers the handshake as a program does, takes every frame down, and may hang up on binary ones."""

    def __init__(self, head: str, *, refuses_binary: bool) -> None:
        self.head, self.refuses_binary = head, refuses_binary
        self.texts: list[dict[str, Any]] = []
        self.binaries: list[dict[str, Any]] = []
        self.connections = 0
        self.port = 0
        self._server: asyncio.Server | None = None

    async def start(self) -> None:
        self._server = await asyncio.start_server(self._serve, "127.0.0.1", 0)
        self.port = self._server.sockets[0].getsockname()[1]

    async def stop(self) -> None:
        assert self._server is not None
        self._server.close()
        await self._server.wait_closed()

    async def _serve(self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        self.connections += 1
        try:
            request = await reader.readuntil(b"\r\n\r\n")
            key = next(
                x.split(b":", 1)[1].strip()
                for x in request.split(b"\r\n")
                if x.lower().startswith(b"sec-websocket-key")
            )
            accept = base64.b64encode(hashlib.sha1(key + _GUID).digest()).decode()
            writer.write(
                f"HTTP/1.1 101 Switching Protocols\r\n{self.head}\r\nUpgrade: websocket\r\nConnection: Upgrade\r\n"
                f"Sec-WebSocket-Accept: {accept}\r\n\r\n".encode()
            )
            while await self._frame(reader):
                pass
        except (asyncio.IncompleteReadError, ConnectionError):
            pass
        finally:
            writer.close()

    async def _frame(self, reader: asyncio.StreamReader) -> bool:
        first, second = await reader.readexactly(2)
        size = second & 0x7F
        if size == 126:
            size = int.from_bytes(await reader.readexactly(2), "big")
        elif size == 127:
            size = int.from_bytes(await reader.readexactly(8), "big")
        mask = await reader.readexactly(4)
        data = bytes(b ^ mask[i % 4] for i, b in enumerate(await reader.readexactly(size)))
        if first & 0xF == 1:
            self.texts.append(json.loads(data))
        elif first & 0xF == 2:
            self.binaries.append(cbor2.loads(data))
            return not self.refuses_binary
        return first & 0xF != 8


Start = Callable[..., Awaitable[tuple[FakeServer, RosbridgeGraph]]]


@pytest.fixture
async def start() -> AsyncIterator[Start]:
    """A function that starts a server and connects a client to it."""
    async with AsyncExitStack() as stack:

        async def begin(head: str, *, refuses_binary: bool = False) -> tuple[FakeServer, RosbridgeGraph]:
            server = FakeServer(head, refuses_binary=refuses_binary)
            await server.start()
            stack.push_async_callback(server.stop)
            client = RosbridgeGraph(f"ws://127.0.0.1:{server.port}", registry=REGISTRY, watch=False)
            await client.open()
            stack.push_async_callback(client.close)
            return server, client

        yield begin


def sample(type: str, **message: Any) -> Sample:
    return Sample(REGISTRY.codec(type).encode(message), type, time.time_ns(), bytes(16), SEQ_NONE)


def advertised(server: FakeServer, topic: str) -> dict[str, Any]:
    return next(t for t in server.texts if t["op"] == "advertise" and t["topic"] == topic)


@pytest.mark.parametrize("encoding", ["auto", "none", "png", "cbor", "cbor-raw", "zip", "rawzip", "zstd"])
async def test_rosbridge_gets_json(start: Start, encoding: str, caplog: pytest.LogCaptureFixture) -> None:
    """A rosbridge server is never sent a binary frame or a compression; what is configured otherwise is said once."""
    server, client = await start(TORNADO, refuses_binary=True)
    publisher = await client.create_publisher("/t", STRING, LATCHED, delivery=Delivery(encoding=encoding))
    publisher.publish(sample(STRING, data="hello"))
    await until(lambda: any(t["op"] == "publish" for t in server.texts))
    assert server.texts[-1] == {"op": "publish", "topic": "/t", "msg": {"data": "hello"}}
    told = advertised(server, "/t")
    assert "compression" not in told
    assert "ropeway" not in told
    assert (told["latch"], told["queue_size"]) == (True, 1)  # for servers that do not know qos
    assert told["qos"]["durability"] == "transient_local"
    assert server.binaries == []
    assert ("goes there as JSON" in caplog.text) == (encoding not in ("auto", "none", "png"))


@pytest.mark.parametrize(
    ("encoding", "used"),
    [("none", None), ("auto", "cbor-raw"), ("cbor", "cbor"), ("zip", "zip"), ("zstd", "rawzip"), ("png", None)],
)
async def test_rosgw_gets_what_it_takes(start: Start, encoding: str, used: str | None) -> None:
    """A rosgw gateway is published to in the encoding that was configured, or the next one that it takes."""
    server, client = await start(ROSGW)
    publisher = await client.create_publisher("/t", STRING, delivery=Delivery(encoding=encoding))
    publisher.publish(sample(STRING, data="hello"))
    await until(lambda: server.binaries or any(t["op"] == "publish" for t in server.texts))
    told = advertised(server, "/t")
    assert told.get("compression") == used
    assert "qos" not in told
    assert [b["compression"] for b in server.binaries] == ([used] if used else [])


@pytest.mark.parametrize(("encoding", "used"), [("none", "cbor-raw"), ("cbor", "cbor-raw"), ("zip", "rawzip")])
async def test_types_that_rosgw_cannot_read(start: Start, encoding: str, used: str) -> None:
    """A type with fields on which rosgw hangs up goes there raw."""
    server, client = await start(ROSGW)
    publisher = await client.create_publisher("/joints", JOINTS, delivery=Delivery(encoding=encoding))
    publisher.publish(sample(JOINTS, name=["a"]))
    await until(lambda: server.binaries)
    assert advertised(server, "/joints")["compression"] == used
    assert server.binaries[0]["compression"] == used


async def test_rosbridge_behind_a_proxy(start: Start, caplog: pytest.LogCaptureFixture) -> None:
    """A server that nobody can tell and that hangs up on binary frames gets JSON in the end."""
    caplog.set_level(logging.WARNING)
    server, client = await start(UNKNOWN, refuses_binary=True)
    publisher = await client.create_publisher("/t", STRING, LATCHED, delivery=Delivery(encoding="cbor"))
    publisher.publish(sample(STRING, data="hello"))
    await until(lambda: any(t["op"] == "publish" for t in server.texts))
    assert server.connections == 3
    assert len(server.binaries) == 2
    assert "goes there as JSON" in caplog.text


def test_what_rosgw_reads() -> None:
    """Lists of texts, of truth values and of bytes, and fixed arrays of other numbers than float64 are beyond it."""
    readable = ("sensor_msgs/msg/Image", "nav_msgs/msg/Odometry", "tf2_msgs/msg/TFMessage", "geometry_msgs/msg/Twist")
    assert all(rosgw_reads(REGISTRY, name) for name in readable)
    beyond = (JOINTS, "std_msgs/msg/Byte", "unique_identifier_msgs/msg/UUID", "shape_msgs/msg/Mesh")
    assert not any(rosgw_reads(REGISTRY, name) for name in beyond)
