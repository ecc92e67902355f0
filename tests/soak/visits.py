"""What visitors do before they leave without a word: one function for each kind of visit."""

from __future__ import annotations

import asyncio
import contextlib
import json
import struct
from collections.abc import Awaitable, Callable
from typing import Any

from ropeway.iort import pack
from ropeway.networks.rosbridge.protocol.dialect import ROPEWAY_SUBPROTOCOL
from ropeway.networks.rosbridge.protocol.records import RecordWriter
from tests.iort.servers import Raw
from tests.support.websocket import Client, fetch

__all__ = ["VISITS", "Visit"]

STRING, FIBONACCI = "std_msgs/String", "example_interfaces/Fibonacci"

Visit = Callable[[list[int], int], Awaitable[None]]
"""A visit to the gateway at these ports; the number makes names its own."""


async def _say(port: int, *operations: dict[str, Any], subprotocol: str = "") -> None:
    """Send operations, wait until they are carried out, and leave."""
    async with Client(port, subprotocol=subprotocol) as client:
        for operation in operations:
            client.send(operation)
        await client.done()


async def publishes(ports: list[int], n: int) -> None:
    about = {"topic": f"/t{n % 7}", "type": STRING}
    await _say(ports[0], {"op": "advertise", **about, "latch": True}, {"op": "publish", **about, "msg": {"data": "x"}})


async def publishes_names_of_its_own(ports: list[int], n: int) -> None:
    await _say(ports[0], {"op": "publish", "topic": f"/own{n}", "type": STRING, "msg": {"data": "x" * 100}})


async def subscribes(ports: list[int], n: int) -> None:
    about = {"topic": f"/t{n % 7}", "type": STRING, "throttle_rate": n % 3, "queue_length": 5}
    kinds = ("none", "png", "cbor", "cbor-raw")
    await _say(ports[0], *({"op": "subscribe", **about, "id": kind, "compression": kind} for kind in kinds))


async def waits_for_a_topic_of_its_own(ports: list[int], n: int) -> None:
    await _say(
        ports[0],
        {"op": "subscribe", "topic": f"/unborn{n}"},
        {"op": "subscribe", "topic": f"/typed{n}", "type": STRING},
    )


async def serves_and_calls(ports: list[int], n: int) -> None:
    service = f"/s{n}"
    async with Client(ports[0]) as client:
        client.send({"op": "advertise_service", "service": service, "type": "std_srvs/Trigger"})
        client.send({"op": "call_service", "service": service, "id": "c", "timeout": 60})
        assert (await client.json())["op"] == "call_service"  # and it is never answered


async def serves_an_action(ports: list[int], n: int) -> None:
    action = f"/a{n}"
    async with Client(ports[0]) as client:
        client.send({"op": "advertise_action", "action": action, "type": FIBONACCI})
        goal = {"action": action, "action_type": FIBONACCI, "args": {"order": 3}, "feedback": True, "id": "g"}
        client.send({"op": "send_action_goal", **goal})
        assert (await client.json())["op"] == "send_action_goal"


async def asks_rosapi(ports: list[int], n: int) -> None:
    names = ("topics", "nodes", "services", "get_param_names", "message_details")
    calls = [{"op": "call_service", "service": f"/rosapi/{name}", "id": name} for name in names]
    await _say(ports[0], *calls, {"op": "call_service", "service": f"/nobody{n}", "id": "n"})


async def leaves_things_half(ports: list[int], n: int) -> None:
    half = json.dumps({"op": "publish", "topic": "/t", "msg": {"data": "x" * 1000}})[:-9]
    pieces = [{"op": "fragment", "id": f"f{k}", "num": 0, "total": 2, "data": "x" * 1000} for k in range(5)]
    async with Client(ports[0]) as client:
        for piece in pieces:
            client.send(piece)
        await client.done()
        client.send(half)
        client.raw(b"\x01\xfe\xff\xff")  # a fragmented frame that goes no further
        await client.writer.drain()


async def is_refused(ports: list[int], n: int) -> None:
    await _say(
        ports[0],
        {"op": "what"},
        {"op": "advertise", "topic": f"/bad name{n}", "type": "x"},
        {"op": "publish", "topic": "/t1", "msg": {"data": 5}},
        {"op": "subscribe", "topic": "/t1", "type": f"unknown_msgs/Type{n}"},
    )


async def is_a_gateway(ports: list[int], n: int) -> None:
    writer, parts = RecordWriter(), []  # type: ignore[var-annotated]
    writer.message(parts, 5, 3, b"\0\1\0\0\2\0\0\0x\0", n.to_bytes(16, "big"), 1, 1)
    writer.first(parts, 5, 3, 50_000, b"begun", n.to_bytes(16, "big"), 2, 2)
    note = {"channel": 5, "type_hash": "RIHS01_00", "definition": f"int32 x{n}\n"}
    async with Client(ports[0], subprotocol=ROPEWAY_SUBPROTOCOL) as client:
        client.send({"op": "hello", "gateway": f"{n:016x}", "name": f"g{n}"})
        client.send({"op": "watch"})
        client.send({"op": "advertise", "topic": "/own", "type": f"own_msgs/msg/Own{n}", "ropeway": note})
        client.send({"op": "advertise", "topic": "/t1", "type": STRING, "ropeway": {"channel": 6}})
        client.send_binary(b"".join(parts))
        client.send({"op": "ping", "t": 1})
        await client.receive()
        await asyncio.sleep(0)


async def asks_over_http(ports: list[int], n: int) -> None:
    for path in ("/", "/healthz", "/readyz", f"/store/S/t{n}", f"/nothing{n}"):
        await fetch(ports[0], path)


async def watches_over_http(ports: list[int], n: int) -> None:
    reader, writer = await asyncio.open_connection("127.0.0.1", ports[0])
    writer.write(f"GET /store?watch=1 HTTP/1.1\r\nHost: 127.0.0.1:{ports[0]}\r\n\r\n".encode())
    await reader.readuntil(b"\r\n\r\n")
    writer.transport.abort()


async def says_nothing(ports: list[int], n: int) -> None:
    port = ports[n % len(ports)]
    _, writer = await asyncio.open_connection("127.0.0.1", port)
    writer.write((b"", b"GET / HTTP/1.1\r\nHost:", b"%01/half", b"\xff" * 20)[n % 4])
    with contextlib.suppress(ConnectionError):
        await writer.drain()
    writer.transport.abort()


async def is_a_page_of_a_stranger(ports: list[int], n: int) -> None:
    async with Client(ports[0], headers={"Origin": f"https://p{n}.example"}) as client:
        assert client.status.startswith("HTTP/1.1 403")
    assert (await fetch(ports[0], "/store", host=f"h{n}.example")).status == 403


async def speaks_something_else(ports: list[int], n: int) -> None:
    reader, writer = await asyncio.open_connection("127.0.0.1", ports[0])
    writer.write((b"\x16\x03\x01\x02\x00\x01" + bytes(500), b"SSH-2.0-x\r\n\r\n")[n % 2])
    assert b" 400 " in await reader.readuntil(b"\r\n")
    writer.transport.abort()


async def resets(ports: list[int], n: int) -> None:
    """Leave with a reset, as a machine that is switched off does once it is back."""
    async with Client(ports[0]) as client:
        client.send({"op": "subscribe", "topic": "/t1", "type": STRING})
        await client.writer.drain()
        socket = client.writer.get_extra_info("socket")
        socket.setsockopt(1, 13, struct.pack("ii", 1, 0))  # SOL_SOCKET, SO_LINGER


async def is_a_robot(ports: list[int], n: int) -> None:
    node = await Raw.connect(ports[1])
    name = f"R{n % 50}"

    async def ask(op: str, topic: str = "-", data: bytes = b"", **head: object) -> None:
        await node.ask(pack("01", name, topic, op, {"n": 1, **head}, data))

    await ask("+hello", v=1)
    await ask("+pub", "pose", b"1,2,3")
    await ask("+adv", "pose")
    node.send(pack("01", name, "*", "+sub", {"n": 2, "last": 0}))
    node.send(pack("01", "-", "-", "+watch", {"n": 3}))
    node.send(f"%01/{name}/pose/s%".encode())
    await node.packet()
    node.writer.transport.abort()


VISITS: tuple[Visit, ...] = (
    publishes,
    publishes_names_of_its_own,
    subscribes,
    waits_for_a_topic_of_its_own,
    serves_and_calls,
    serves_an_action,
    asks_rosapi,
    leaves_things_half,
    is_refused,
    is_a_gateway,
    asks_over_http,
    watches_over_http,
    says_nothing,
    is_a_page_of_a_stranger,
    speaks_something_else,
    resets,
    is_a_robot,
)
