"""100,000 hostile frames to a running server over real sockets, after which it still forwards."""

from __future__ import annotations

import asyncio
import contextlib
import json
import random
import sys
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager
from typing import Any, Final

import cbor2
import lz4.frame
import psutil
import pytest

from ropeway import aio
from ropeway.aio import BaseExceptionGroup
from ropeway.delivery.compression import filters
from ropeway.networks.rosbridge.protocol import codec
from ropeway.networks.rosbridge.protocol.dialect import ROPEWAY_SUBPROTOCOL
from ropeway.networks.rosbridge.protocol.records import RecordWriter
from ropeway.types import TypeRegistry
from tests.networks.rosbridge.server.test_session import CHATTER, heard, listen, said
from tests.support.messages import STRING, text
from tests.support.until import PATIENCE_S
from tests.support.websocket import BINARY, TEXT, Client, ClosedByServer, frame

FRAMES: Final = 100_000
CONNECTIONS: Final = 6
LIFE_FRAMES: Final = 1000  # then a connection is left and another one made
BATCH: Final = 25
GROWTH_BYTES: Final = 40 << 20

ODD: Final = ("null", "-1", "1e308", "NaN", "true", '""', "[]", "{}", "9" * 50, '"\\u0000"', '"\\ud800"', '"/x"', "0.5")

DEEP: Final[Any] = [[[{"a": [{"b": [None]}]}]]]
ODD_VALUES: Final[tuple[Any, ...]] = (
    *(None, True, False, 0, -1, 1, 65535, 65536, 2**31, 2**63, 2**64, -(2**63) - 1, 10**30, 0.5, 1e308, -0.0),
    *(float("nan"), float("inf"), "", "x", "/", "/chatter", "~", "a b", "\0", "ü🚡", "x" * 3000, "std_msgs/String"),
    *("sensor_msgs/msg/PointCloud2", "now", [], {}, [1], [None], ["x"] * 50, {"": ""}, {"sec": 1}, DEEP),
    *(b"", b"\0\1\0\0", {1: 2}, cbor2.CBORTag(85, b"1234"), cbor2.undefined),
)


def texts() -> list[bytes]:
    """One good operation of every kind, and of every dialect."""
    goal = {"action": "/a", "action_type": "example_interfaces/Fibonacci", "args": {"order": 1}, "id": "g"}
    call = {"call": "0" * 31 + "1", "via": ["a"], "caller": "b", "encoding": "zstd", "definition": "int32 x\n---\n"}
    note = {"ropeway": {"channel": 5, "priority": 0, "depth": 3, "rate_hz": 10.0, "lifespan_s": 1.0, "weight": 2.0}}
    typed = {"channel": 6, "type_hash": "RIHS01_00", "definition": "int32 x\nstring[<=5] y\n"}
    qos = {
        "reliability": "best_effort",
        "durability": "transient_local",
        "depth": 5,
        "lifespan": {"secs": 1, "nsecs": 2},
    }
    operations: list[dict[str, Any]] = [
        {**CHATTER, "id": "a", "latch": True, "queue_size": 5},
        {**CHATTER, "topic": "/q", "qos": qos},
        {**CHATTER, "topic": "/image", "type": "sensor_msgs/Image"},
        {"op": "unadvertise", "topic": "/chatter", "id": "a"},
        said("hello", id="p"),
        said("hello", "/auto", type="std_msgs/String"),
        {"op": "publish", "topic": "/image", "msg": {"header": {"stamp": {"sec": 1}}, "height": 2, "data": "AAEC"}},
        listen(id="s", throttle_rate=5, queue_length=2, fragment_size=100, compression="png"),
        listen("/image", type="sensor_msgs/Image", compression="cbor"),
        listen("/q", compression="cbor-raw", qos=qos),
        {"op": "unsubscribe", "topic": "/chatter", "id": "s"},
        {"op": "fragment", "id": "f", "data": '{"op":"unsub', "num": 0, "total": 2},
        {"op": "fragment", "id": "f", "data": 'scribe","topic":"/x"}', "num": 1, "total": 2},
        {"op": "call_service", "service": "/rosapi/topics", "args": {}, "id": "c", "timeout": 1.0},
        {"op": "service_response", "service": "/s", "values": {}, "result": True, "id": "c"},
        {"op": "advertise_service", "service": "/s", "type": "std_srvs/SetBool"},
        {"op": "call_service", "service": "/s", "args": {"data": True}, "id": "c", "timeout": 0.05, "ropeway": call},
        {"op": "service_response", "service": "/s", "id": "service_request:/s:1", "values": {}, "result": True},
        {"op": "unadvertise_service", "service": "/s"},
        {"op": "send_action_goal", **goal},
        {"op": "cancel_action_goal", "action": "/a", "id": "g"},
        {"op": "advertise_action", "action": "/a", "type": "example_interfaces/Fibonacci"},
        {"op": "action_result", "action": "/a", "id": "action_goal:/a:1", "values": {}, "result": True},
        {"op": "unadvertise_action", "action": "/a"},
        {"op": "accepted", "id": "action_goal:/a:1"},
        {"op": "cancelling", "id": "action_goal:/a:1", "agreed": True},
        {"op": "action_feedback", "action": "/a", "values": {}, "id": "g"},
        {"op": "action_result", "action": "/a", "values": {}, "status": 4, "result": True, "id": "g"},
        {"op": "png", "data": "iVBORw0KGgo="},
        {"op": "status", "level": "info", "msg": "x"},
        {"op": "hello", "gateway": "x", "name": "y"},
        {"op": "watch"},
        {"op": "ping", "t": 1},
        {"op": "pong", "t": 1, "r": 2},
        {"op": "demand", "channel": 5, "count": 1},
        {"op": "adopted", "channel": 5, "qos": qos, "definition": "int32 x"},
        {"op": "graph", "topics": {"/x": {"types": ["a/b"]}}, "nodes": {"/n": None}},
        {"op": "refused", "channel": 5, "reason": "no"},
        {"op": "stats", "channel": 5, "delay_ms": 1},
        {**CHATTER, **note},
        {**CHATTER, "topic": "/own", "type": "my_msgs/msg/Own", "ropeway": typed},
        {**listen("/in"), **note},
        {"op": "unsubscribe", "topic": "/in", "id": None},
    ]
    return [json.dumps(op).encode() for op in operations]


def binaries() -> list[bytes]:
    """Good binary frames: every encoding in CBOR, and records."""
    registry = TypeRegistry()
    string = registry.codec(STRING)
    payload = text("hello hello hello")
    operation = {"op": "publish", "topic": "/chatter"}
    out = [codec.encode_publish("/chatter", payload, string, name, stamp_ns=1).data for name in ("cbor", "cbor-raw")]
    for name in ("zip", "rawzip", "cbor-raw", "zstd"):
        body = codec.encode_msg(name, payload, string)
        out.append(cbor2.dumps({**operation, "msg": body, "compression": name}))
    image = {"height": 2, "width": 2, "encoding": "rgb8", "step": 6, "data": cbor2.CBORTag(64, bytes(12))}
    out.append(cbor2.dumps({"op": "publish", "topic": "/image", "msg": image}))
    out.append(cbor2.dumps({**operation, "msg": lz4.frame.compress(bytes(5000)), "compression": "rawzip"}))
    out += [cbor2.dumps(json.loads(op)) for op in texts()[:10]]
    writer = RecordWriter()
    for number in range(8):
        parts: list[bytes] = []
        for channel in (5, 6):
            body = filters.encode(payload, STRING) if number == 6 else payload
            writer.message(parts, channel, number, body, bytes([number]) * 16, number, 1, bool(number & 1))
        out.append(b"".join(parts))
    parts = []
    writer.first(parts, 5, 3, 1000, payload, b"x" * 16, 1, 1)
    out.append(b"".join(parts))
    parts = []
    writer.more(parts, 5, bytes(1000 - len(payload)))
    out.append(b"".join(parts))
    return out


class Hostile:
    """Makes frames. The seed gives the same ones each time."""

    def __init__(self, seed: int) -> None:
        self.random = random.Random(seed)
        self.texts, self.binaries = texts(), binaries()

    def frame(self) -> bytes:
        """One frame, as it goes over the socket."""
        dice = self.random.random
        if dice() < 0.02:
            return frame(self.random.choice((TEXT, BINARY)), self.random.randbytes(self.random.randrange(200)))
        binary = dice() < 0.4
        data = bytearray(self.random.choice(self.binaries if binary else self.texts))
        if dice() < 0.3:
            data = self.rewritten(data, binary)
        elif dice() < 0.95:
            for _ in range(self.random.choice((1, 1, 1, 2, 5))):
                data = self.mutated(data)
        opcode = (BINARY if binary else TEXT) if dice() < 0.97 else self.random.choice((TEXT, BINARY))
        if dice() < 0.02 and len(data) > 3:
            cut = self.random.randrange(1, len(data))
            return frame(opcode, bytes(data[:cut]), fin=False) + frame(0, bytes(data[cut:]))
        return frame(opcode, bytes(data))

    def rewritten(self, data: bytearray, binary: bool) -> bytearray:
        """The operation with another value somewhere, well-formed."""
        try:
            value = cbor2.loads(data) if binary else json.loads(data)
        except ValueError:  # records
            return data
        at = value
        while isinstance(at, (dict, list)) and at:
            key = self.random.choice(list(at) if isinstance(at, dict) else range(len(at)))
            if self.random.random() < 0.5 or not isinstance(at[key], (dict, list)):
                at[key] = self.random.choice(ODD_VALUES if binary else ODD_VALUES[:-5])
                break
            at = at[key]
        return bytearray(cbor2.dumps(value) if binary else json.dumps(value).encode())

    def last(self) -> bytes:
        """What may end a connection."""
        data = self.random.choice(self.texts)
        kind = self.random.randrange(4)
        if kind == 0:
            return data
        if kind == 1:
            return frame(
                self.random.randrange(16), data[:100], fin=self.random.random() < 0.5, rsv=self.random.randrange(8)
            )
        return frame(TEXT, data)[: self.random.randrange(len(data))] if kind == 2 else b""

    def mutated(self, data: bytearray) -> bytearray:
        kind = self.random.randrange(8)
        at = self.random.randrange(len(data) + 1)
        if kind == 0 and data:
            data[at % len(data)] ^= 1 << self.random.randrange(8)
        elif kind == 1 and data:
            data[at % len(data)] = self.random.choice(b'\0\xff\x7f"{}[]\\,:0\xa0\x80')
        elif kind == 2:
            del data[at:]
        elif kind == 3:
            del data[at : at + self.random.randrange(1, 9)]
        elif kind == 4:
            data[at:at] = self.random.randbytes(self.random.randrange(1, 9))
        elif kind == 5:
            other = self.random.choice(self.binaries + self.texts)
            data[at:] = other[self.random.randrange(len(other)) :]
        elif kind == 6:
            data[at:at] = data[at : at + 60] * self.random.choice((1, 2, 50))
        else:  # another value somewhere in a JSON object
            fields = data.split(b": ")
            if len(fields) > 1:
                i = self.random.randrange(1, len(fields))
                end = next((j for j, c in enumerate(fields[i]) if c in b",}]"), len(fields[i]))
                fields[i][:end] = self.random.choice(ODD).encode()
                data = bytearray(b": ").join(fields)
        return data


@asynccontextmanager
async def server() -> AsyncIterator[tuple[int, psutil.Process, list[str]]]:
    """The port, the process and the lines of its log."""
    process = await asyncio.create_subprocess_exec(
        sys.executable,
        "-m",
        "tests.networks.rosbridge.server.serve",
        stdin=asyncio.subprocess.PIPE,
        stdout=asyncio.subprocess.PIPE,
        stderr=asyncio.subprocess.PIPE,
    )
    assert process.stdin is not None
    assert process.stdout is not None
    lines: list[str] = []

    async def read(stream: asyncio.StreamReader) -> None:
        async for line in stream:
            lines.append(line.decode(errors="replace"))

    assert process.stderr is not None
    reading = asyncio.create_task(read(process.stderr))
    try:
        yield int(await process.stdout.readline()), psutil.Process(process.pid), lines
    finally:
        process.stdin.close()
        try:
            async with aio.timeout(10):
                await process.wait()
        except TimeoutError:
            process.kill()
            await process.wait()
        await reading


END: Final = b'"id":"the end"'


async def attack(port: int, seed: int, count: int, subprotocol: str, sent: list[int]) -> None:
    """Send ``count`` hostile frames, on as many connections as it takes, each until the server has dealt with all."""
    hostile = Hostile(seed)

    async def answered(client: Client) -> bool:
        """Read and ignore what comes, until the last answer; false if the server has closed before."""
        kept = b""
        with contextlib.suppress(ConnectionError):
            while END not in kept and (data := await client.reader.read(1 << 20)):
                kept = kept[-len(END) :] + data
        return END in kept

    while count > 0:
        async with Client(port, subprotocol=subprotocol) as client:
            reading = asyncio.create_task(answered(client))
            for _ in range(0, min(LIFE_FRAMES, count), BATCH):
                client.raw(b"".join(hostile.frame() for _ in range(BATCH)))
                count -= BATCH
                sent[0] += BATCH
                await client.writer.drain()
            client.send({"op": "call_service", "service": "/nowhere", "id": "the end"})
            await client.writer.drain()
            async with aio.timeout(PATIENCE_S):
                assert await reading, "the server has closed the connection"
            client.raw(hostile.last())
            await client.writer.drain()


@pytest.mark.slow
async def test_hostile_frames() -> None:
    """The server lives through them, forwards before, meanwhile and afterwards, and its memory stays what it was."""
    async with server() as (port, process, lines), Client(port) as talker, Client(port) as listener:
        listener.send(listen("/good"))
        await listener.done()
        talker.send({**CHATTER, "topic": "/good"})
        sent, over = [0], asyncio.Event()
        memory: list[int] = []

        async def forwards(number: int) -> None:
            talker.send(said(str(number), "/good"))
            assert await listener.json() == heard(str(number), "/good")

        async def watch() -> None:
            number = 0
            while not over.is_set():
                await forwards(number)
                number += 1
                memory.append(process.memory_info().rss)
                await asyncio.sleep(0.1)

        share = FRAMES // CONNECTIONS + BATCH
        try:
            async with aio.TaskGroup() as group:
                group.create_task(watch())
                attacks = [
                    group.create_task(attack(port, seed, share, ROPEWAY_SUBPROTOCOL if seed % 2 else "", sent))
                    for seed in range(CONNECTIONS)
                ]
                await asyncio.wait(attacks)
                over.set()
        except BaseExceptionGroup as failed:
            if failed.split(ClosedByServer)[1] is not None:  # something else went wrong, too
                raise
            raise AssertionError("".join(lines[-50:])) from failed
        assert sent[0] >= FRAMES
        for number in range(100):
            await forwards(1_000_000 + number)
        settled = memory[len(memory) // 3]
        print([m >> 20 for m in memory])
        assert process.memory_info().rss - settled < GROWTH_BYTES, [m >> 20 for m in memory]
    assert not [line for line in lines if "Traceback" in line or line.startswith("ERROR")], _around(lines)


def _around(lines: list[str]) -> str:
    """The first trouble that a server told, and what came before and after."""
    at = next(i for i, line in enumerate(lines) if "Traceback" in line or line.startswith("ERROR"))
    return "".join(lines[max(0, at - 3) : at + 40])
