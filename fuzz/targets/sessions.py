"""Whole conversations with the servers of this process, over sockets: whatever is said, nothing fails unforeseen.

A fault here is an exception that nobody expected (the loop's handler gets it, or the log has its traceback), and a
server that does not answer any more.
"""

from __future__ import annotations

import asyncio
import contextlib
import json
import logging
from collections.abc import Coroutine
from typing import Any, Final

import cbor2
from tests.iort.servers import Raw
from tests.support.websocket import Client, ClosedByServer

from fuzz.target import Target
from fuzz.targets.operations import OPERATIONS
from fuzz.targets.viewers import VIEWER_FRAMES, VIEWER_OPERATIONS
from ropeway.hub.hub import Hub
from ropeway.iort import pack
from ropeway.listener.connection import Limits
from ropeway.listener.subprotocols import FOXGLOVE_SUBPROTOCOLS
from ropeway.networks.foxglove.server import FoxgloveServer
from ropeway.networks.iort.server import IortServer
from ropeway.networks.iort.space import Space
from ropeway.networks.memory.graph import MemoryGraph
from ropeway.networks.rosbridge.protocol.dialect import ROPEWAY_SUBPROTOCOL
from ropeway.networks.rosbridge.protocol.records import RecordWriter
from ropeway.networks.rosbridge.server import RosbridgeServer
from ropeway.store import Store, make_backend
from ropeway.types import TypeRegistry

__all__ = ["TARGETS"]

_MARK: Final = b"\n"
_ANSWER_S: Final = 20.0
_BINARY: Final = 0x80  # what begins with this bit goes in a binary frame


class _Unforeseen(logging.Handler):
    """Keeps what was logged with a traceback, and what the loop says of itself."""

    def __init__(self) -> None:
        super().__init__(logging.ERROR)
        self.found: list[str] = []

    def emit(self, record: logging.LogRecord) -> None:
        if record.exc_info or record.name == "asyncio":
            self.found.append(self.format(record))


class _World:
    """The servers, with a loop of their own."""

    def __init__(self) -> None:
        self.loop = asyncio.new_event_loop()
        self.unforeseen = _Unforeseen()
        logging.getLogger().addHandler(self.unforeseen)
        logging.getLogger("ropeway").propagate = True
        self.loop.run_until_complete(self._open())

    async def _open(self) -> None:
        graph = MemoryGraph("fuzz")
        await graph.open()
        hub, registry = Hub(graph, gateway_id="f" * 16), TypeRegistry()
        self.viewers = FoxgloveServer(hub, registry, call_timeout_s=0.01, params_timeout_s=0.01)
        self.server = RosbridgeServer(
            hub,
            registry,
            guests=self.viewers,
            limits=Limits(max_message_bytes=1 << 16),
            gateway_id="f" * 16,
            unregister_timeout_s=0.0,
            call_timeout_s=0.01,
        )
        self.port = (await self.server.listen("ws://127.0.0.1:0")).port
        store = Store(make_backend("memory:"))
        await store.open()
        self.nodes = IortServer(Space(store))
        self.nodes_port = await self.nodes.listen("iort://127.0.0.1:0")

    def run(self, conversation: Coroutine[Any, Any, None]) -> None:
        self.unforeseen.found.clear()
        self.loop.run_until_complete(conversation)
        assert not self.unforeseen.found, "\n".join(self.unforeseen.found)


_world: _World | None = None


def _open() -> _World:
    global _world
    if _world is None:
        _world = _World()
    return _world


def _session(data: bytes) -> None:
    """Frames between line feeds; the first byte tells whether the client is a gateway."""
    world = _open()
    world.run(_talk(world, ROPEWAY_SUBPROTOCOL if data[:1] == b"g" else "", data[1:].split(_MARK)))


def _viewer(data: bytes) -> None:
    """Frames of a viewer between line feeds; a byte beyond ASCII before one makes it binary."""
    world = _open()
    world.run(_talk(world, FOXGLOVE_SUBPROTOCOLS[0], data.split(_MARK)))


async def _talk(world: _World, subprotocol: str, frames: list[bytes]) -> None:
    with contextlib.suppress(ClosedByServer, ConnectionError, asyncio.IncompleteReadError):
        async with Client(world.port, subprotocol=subprotocol) as client:
            for frame in frames:
                if frame and frame[0] & _BINARY:
                    client.send_binary(frame[1:] if subprotocol in FOXGLOVE_SUBPROTOCOLS else frame)
                else:
                    client.send(frame)
            client.send({"op": "unsubscribe", "topic": "/x"})
            client.raw(b"\x89\x80" + bytes(4))  # a ping, which is answered once all before it was read
            while True:
                opcode, _, payload = await asyncio.wait_for(client._frame(), _ANSWER_S)
                if opcode == 8:
                    raise ClosedByServer(1000, payload.decode(errors="replace"))
                if opcode == 10:
                    break
    await _answers(world)


async def _answers(world: _World) -> None:
    """Somebody else is served as before."""
    async with Client(world.port) as other:
        other.send({"op": "call_service", "service": "/rosapi/get_time", "id": "t"})
        answer = await asyncio.wait_for(other.json(), _ANSWER_S)
        assert answer["result"]


def _node(data: bytes) -> None:
    world = _open()
    world.run(_tell(world, data))


async def _tell(world: _World, data: bytes) -> None:
    """A stream as a robot sends it, then a question of another robot."""
    first = await Raw.connect(world.nodes_port)
    first.send(data + b"%")
    with contextlib.suppress(ConnectionError):
        await first.writer.drain()
    second = await Raw.connect(world.nodes_port)
    assert (await second.ask(pack("01", "-", "-", "+ping", {"n": 1}))).op == "+ok"
    for node in (first, second):
        node.writer.transport.abort()
    await asyncio.sleep(0)


def _texts() -> list[bytes]:
    lines = [json.dumps(operation).encode() for operation in OPERATIONS]
    writer, parts = RecordWriter(), []  # type: ignore[var-annotated]
    writer.message(parts, 5, 3, b"\0\1\0\0\2\0\0\0x\0", bytes(16), 1, 1)
    hello = [b'{"op":"hello","gateway":"00","name":"a"}', b'{"op":"watch"}', b'{"op":"ping","t":1}']
    note = {"channel": 5, "type_hash": "RIHS01_00", "definition": "int32 x\n"}
    own = {"op": "advertise", "topic": "/own", "type": "own_msgs/msg/Own", "ropeway": note}
    return [
        *(b"c" + line for line in lines),
        b"c" + _MARK.join(lines[:4]),
        b"g" + _MARK.join([*hello, json.dumps(own).encode(), *lines[:2]]),
        b"c" + cbor2.dumps({"op": "publish", "topic": "/t", "msg": {"data": "x"}}),
    ]


def _packets() -> list[bytes]:
    said = (
        pack("01", "R", "-", "+hello", {"n": 1, "v": 1}),
        pack("01", "R", "t", "+pub", {"n": 2, "v": 3, "t": 4, "m": 1}, b"1"),
        pack("01", "R", "*", "+sub", {"n": 3, "last": 1}),
        pack("01", "R", "t", "+get", {"n": 4}),
        pack("01", "-", "-", "+watch", {"n": 5}),
        pack("01", "R", "t", "+adv", {"n": 6, "k": "std_msgs/msg/String"}),
        pack("01", "R", "t", "+del", {"n": 7}),
        pack("01", "R", "*", "+list", {"n": 8}),
        b"%01/R/t/p/1%%01/R/t/s%",
    )
    return [*said, b"".join(said)]


def _views() -> list[bytes]:
    lines = [json.dumps(operation).encode() for operation in VIEWER_OPERATIONS]
    frames = [b"\xff" + frame for frame in VIEWER_FRAMES if _MARK not in frame]
    return [_MARK.join(lines), _MARK.join([lines[2], *frames]), *lines, *frames]


TARGETS: Final = {
    "viewer-sessions": Target(
        _viewer,
        (),
        _views,
        (
            b"\n",
            b'{"op":"',
            b'"channels":[',
            b'"id":1',
            b'"channelId":1',
            b"\xff\x01",
            b"\xff\x02",
            b'"parameterNames":[]',
        ),
        memory_bytes=32 << 20,
        cpu_s=2.0,
    ),
    "sessions": Target(
        _session,
        (),
        _texts,
        (
            b"\n",
            b'"ropeway":{',
            b'"channel":5',
            b'"demand"',
            b'"adopted"',
            b'"graph"',
            b'"stats"',
            b'"/rosapi/topics"',
            b'"id":',
        ),
        memory_bytes=32 << 20,
        cpu_s=2.0,
    ),
    "node-sessions": Target(
        _node,
        (),
        _packets,
        (b"%", b"/+sub/n=", b"/+unsub/n=", b"/+unadv/n=", b"last=1", b"token=", b"*", b"[a-z]"),
        cpu_s=2.0,
    ),
}
