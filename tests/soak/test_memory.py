"""A megabyte of anything makes a gateway hold a few megabytes, and nothing once who sent it has left."""

from __future__ import annotations

import asyncio
import itertools
import json
import struct
from collections.abc import Iterator
from contextlib import AsyncExitStack
from typing import Any

import cbor2
import psutil
import pytest

from ropeway.wire.dialect import ROPEWAY_SUBPROTOCOL
from ropeway.wire.records import RecordWriter
from tests.server.client import BINARY, CONTINUATION, TEXT, Client, frame
from tests.soak.process import serving
from tests.support.actions import FIBONACCI

SENT_BYTES = 1 << 20
PUBLISHERS = 1000  # of the kind whose every frame makes one; a client may have 4,096
PEAK_BYTES = 32 << 20  # CBOR and JSON may take 24 times their bytes for the moment in which they are read
LEFT_BYTES = 16 << 20  # what the allocator keeps for the next
STRING = "std_msgs/String"
CONFIG = {
    "gateway": {
        "name": "memory",
        "graphs": ["memory:memory"],
        "listen": ["ws://127.0.0.1:0"],
        "clients": {"unregister_timeout_s": 0.2},
    }
}
TEXT_OF = "x" * 1000

pytestmark = [pytest.mark.slow, pytest.mark.timeout(300)]


def operation(op: str, **fields: Any) -> bytes:
    return frame(TEXT, json.dumps({"op": op, **fields}).encode())


def records(*pieces: bytes) -> bytes:
    return frame(BINARY, b"".join(pieces))


def first(channel: int, total: int) -> bytes:
    out: list[bytes] = []
    RecordWriter().first(out, channel, 3, total, b"x", b"o" * 16, 1, 1)
    return b"".join(out)


def told(number: int, text: str) -> bytes:
    about = {"topic": f"/t{number}", "type": f"my_msgs/msg/T{number}"}
    return operation("advertise", **about, ropeway={"channel": number, "definition": text})


PLAIN: dict[str, Any] = {
    "advertise": lambda n: operation("advertise", topic=f"/t{n}", type=STRING, latch=True),
    "advertise_deep": lambda n: operation(
        "advertise", topic=f"/t{n}", type=STRING, qos={"durability": "transient_local", "depth": 2**31 - 1}
    )
    + operation("publish", topic=f"/t{n}", msg={"data": "x"}),
    "publish": lambda n: operation("publish", topic="/t", type=STRING, msg={"data": TEXT_OF}),
    "publish_unknown": lambda n: operation("publish", topic=f"/t{n}", msg={"data": TEXT_OF}),
    "subscribe": lambda n: operation("subscribe", topic=f"/t{n % 50}", type=STRING, id=f"{n}"),
    "subscribe_throttled": lambda n: operation(
        "subscribe", topic="/t", type=STRING, throttle_rate=600_000, queue_length=10**9
    )
    + operation("publish", topic="/t", type=STRING, msg={"data": TEXT_OF}),
    "subscribe_unborn": lambda n: operation("subscribe", topic=f"/unborn{n}", id=TEXT_OF[:900]),
    "unsubscribe": lambda n: operation("unsubscribe", topic=f"/t{n}"),
    "call_service": lambda n: operation("call_service", service=f"/s{n}", id=f"{n}", args={"data": TEXT_OF}),
    "advertise_service": lambda n: operation("advertise_service", service=f"/s{n}", type="std_srvs/Trigger"),
    "advertise_action": lambda n: operation("advertise_action", action=f"/a{n}", type=FIBONACCI),
    "service_response": lambda n: operation("service_response", service="/s", id=f"{n}", values={}, result=True),
    "fragment": lambda n: operation("fragment", id=f"{n % 100}", data="", num=n // 100, total=60_000),
    "long_names": lambda n: operation("subscribe", topic="/" + "a" * 10_000, type=STRING, id=f"{n}"),
    "long_ids": lambda n: operation("subscribe", topic="/t", type=STRING, id="a" * 10_000 + f"{n}"),
    "unknown_types": lambda n: operation("advertise", topic=f"/t{n}", type=f"sensor_msgs/Imag{n}"),
    "unfinished_json": lambda n: frame(TEXT, b'{"op": "publish", "msg": {"data": "' + b"x" * 1000),
    "no_json": lambda n: frame(TEXT, b"[{" * 500),
    "json_lists": lambda n: frame(TEXT, b'{"op": "publish", "msg": [' + b"[]," * 30_000 + b"1]}"),
    "cbor_lists": lambda n: frame(BINARY, b"\xa1\x63msg\x9a" + (100_000).to_bytes(4, "big") + b"\x80" * 100_000),
    "cbor": lambda n: frame(BINARY, cbor2.dumps({"op": "publish", "topic": "/t", "type": STRING, "msg": {}})),
    "pieces": lambda n: frame(TEXT if n == 0 else CONTINUATION, b"x" * 1000, fin=False),
}  # fmt: skip
GATEWAY: dict[str, Any] = {
    "first_records": lambda n: records(first(n % 60_000 + 1, 64 << 20)),
    "origins": lambda n: records(struct.pack("<BBHHHIQq", 4, 0, 0, n % 4096, 0, 16, 0, 0), struct.pack("<QQ", n, n)),
    "definition_of_texts": lambda n: told(n % 60_000 + 1, "string[16777215] a\n"),
    "definition_of_fields": lambda n: told(n % 60_000 + 1, "".join(f"bool a{i}\n" for i in range(20_000))),
    "definitions": lambda n: told(n % 60_000 + 1, "bool a\n"),
    "watch": lambda n: operation("watch") if n == 0 else operation("ping", t=n),
}
MANY_PARTS = {PLAIN["advertise"]}
MANY_LEFT_BYTES = 40 << 20  # a thousand publishers at a time, all withdrawn again: their pages are not given back

KINDS = [*((name, "", make) for name, make in PLAIN.items())]
KINDS += [(name, ROPEWAY_SUBPROTOCOL, make) for name, make in GATEWAY.items()]


def a_megabyte(make: Any) -> Iterator[bytes]:
    """Frames of one kind, until so many bytes are sent."""
    sent = 0
    for number in itertools.count():
        data = make(number)
        sent += len(data)
        if (sent > SENT_BYTES and number) or (make is PLAIN["advertise_deep"] and number >= PUBLISHERS):
            return
        yield data


async def dealt_with(gateway: psutil.Process, timeout_s: float = 60) -> int:
    """Wait until the process has nothing more to do; give the most that it had resident meanwhile."""
    most = idle = 0
    async with asyncio.timeout(timeout_s):
        while idle < 3:
            before = sum(gateway.cpu_times()[:2])
            for _ in range(10):
                most = max(most, gateway.memory_info().rss)
                await asyncio.sleep(0.02)
            idle = idle + 1 if sum(gateway.cpu_times()[:2]) - before < 0.05 else 0
    return most


@pytest.mark.parametrize(("subprotocol", "make"), [kind[1:] for kind in KINDS], ids=[kind[0] for kind in KINDS])
async def test_a_megabyte(subprotocol: str, make: Any) -> None:
    """A gateway that gets a megabyte holds some more while it is there, and is what it was once all have left."""
    async with serving(CONFIG) as gateway:
        process = psutil.Process(gateway.process.pid)
        async with Client(gateway.ports[0]) as client:  # what is made for the first visitor stays
            client.raw(PLAIN["advertise"](0))
            await client.done()
        before = await gateway.settled()
        async with AsyncExitStack() as stack:
            client = await stack.enter_async_context(Client(gateway.ports[0], subprotocol=subprotocol))
            reading = asyncio.create_task(_read_all(client))
            try:
                for data in a_megabyte(make):
                    client.raw(data)
                    await client.writer.drain()
            except ConnectionError:
                pass  # closed with a reason, which is as good
            peak = await dealt_with(process)
            reading.cancel()
        after = await gateway.settled(before, at_most=1100)
    assert peak - before.rss_bytes < PEAK_BYTES
    assert after.grown(before, at_most=1100) == {}
    assert after.rss_bytes - before.rss_bytes < (MANY_LEFT_BYTES if make in MANY_PARTS else LEFT_BYTES)


async def _read_all(client: Client) -> None:
    while await client.reader.read(1 << 20):
        pass
