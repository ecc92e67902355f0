"""Services that viewers call."""

from __future__ import annotations

import asyncio
import json
import struct
from typing import Any

import pytest

from ropeway.errors import CallFailed
from ropeway.graph.calls import Request
from ropeway.limits import CALLS_PER_CLIENT
from tests.networks.foxglove.viewer import Sight, Viewer
from tests.support.services import ADD, TEXT, Gate, add, addends, total
from tests.support.until import until


def call(service: int, number: int, data: bytes, encoding: str = "cdr") -> bytes:
    """Return the frame of a call."""
    return struct.pack("<BIII", 2, service, number, len(encoding)) + encoding.encode() + data


async def answer(viewer: Viewer) -> tuple[int, int, str, bytes]:
    """Wait for the answer of a call, and return its service, its call, its encoding and its body."""
    await viewer.until(lambda: viewer.binary)
    data = viewer.binary.pop(0)
    opcode, service, number, length = struct.unpack_from("<BIII", data)
    assert opcode == 3
    return service, number, data[13 : 13 + length].decode(), data[13 + length :]


async def test_a_service_is_told(sight: Sight) -> None:
    """A service is told with the schemas of its request and response, and taken back when it goes."""
    service = await sight.robot.create_service("/add", ADD, add)
    viewer = await sight.viewer()
    told = await viewer.service("/add")
    assert told["type"] == ADD
    assert told["request"] == {
        "encoding": "cdr",
        "schemaName": f"{ADD}_Request",
        "schemaEncoding": "ros2msg",
        "schema": told["requestSchema"],
    }
    assert told["requestSchema"].split() == ["int64", "a", "int64", "b"]
    assert told["responseSchema"].split() == ["int64", "sum"]
    await service.close()
    await viewer.until(lambda: not viewer.services)


@pytest.mark.parametrize(("encoding", "ask", "told"), [("cdr", addends(2, 3), total(5)), ("json", b'{"a":2,"b":3}', 5)])
async def test_calling(sight: Sight, encoding: str, ask: bytes, told: Any) -> None:
    """A call is answered in the encoding in which it came, under its own number."""
    await sight.robot.create_service("/add", ADD, add)
    viewer = await sight.viewer()
    number = (await viewer.service("/add"))["id"]
    viewer.send_binary(call(number, 42, ask, encoding))
    *about, body = await answer(viewer)
    assert about == [number, 42, encoding]
    assert (json.loads(body)["sum"] if encoding == "json" else body) == told


@pytest.mark.parametrize(
    ("encoding", "ask", "said"),
    [
        ("cdr", b"\0\1\0\0\1", "AddTwoInts_Request"),
        ("cdr", b"", "AddTwoInts_Request"),
        ("json", b'{"a":"x"}', "a"),
        ("json", b"{", "JSON"),
        ("json", b"[" * 5000, "not JSON"),
        ("protobuf", b"", "encoding"),
    ],
)
async def test_bad_requests(sight: Sight, encoding: str, ask: bytes, said: str) -> None:
    """A request that is not of its type, or of an encoding that is not known, fails with the reason."""
    await sight.robot.create_service("/add", ADD, add)
    viewer = await sight.viewer()
    number = (await viewer.service("/add"))["id"]
    viewer.send_binary(call(number, 7, ask, encoding))
    failure = await viewer.op("serviceCallFailure")
    assert (failure["serviceId"], failure["callId"]) == (number, 7)
    assert said in failure["message"]
    await viewer.passed()


async def test_services_that_fail(sight: Sight) -> None:
    """A service that fails, and one that is not there, are answered with why."""

    async def fail(_: Request) -> bytes:
        raise CallFailed("/add", "the adder is out of order")

    await sight.robot.create_service("/add", ADD, fail)
    viewer = await sight.viewer()
    number = (await viewer.service("/add"))["id"]
    viewer.send_binary(call(number, 1, addends(1)))
    assert "out of order" in (await viewer.op("serviceCallFailure"))["message"]
    viewer.send_binary(call(999, 2, addends(1)))
    assert "there is no service 999" in (await viewer.op("serviceCallFailure"))["message"]


async def test_many_calls_at_a_time(sight: Sight) -> None:
    """Calls do not wait for each other, each is answered once, and one too many fails."""
    gate = Gate()
    await sight.robot.create_service("/slow", ADD, gate)
    await sight.robot.create_service("/add", ADD, add)
    viewer = await sight.viewer()
    slow, fast = (await viewer.service("/slow"))["id"], (await viewer.service("/add"))["id"]
    for number in range(CALLS_PER_CLIENT - 1):
        viewer.send_binary(call(slow, number, addends(number)))
    viewer.send_binary(call(fast, 9999, addends(1, 1)))
    assert (await answer(viewer))[1] == 9999
    viewer.send_binary(call(slow, 5000, addends(1)))
    viewer.send_binary(call(slow, 5001, addends(1)))
    assert (await viewer.op("serviceCallFailure"))["callId"] == 5001
    gate.open.set()
    answers = {(await answer(viewer))[1] for _ in range(CALLS_PER_CLIENT)}
    assert answers == {*range(CALLS_PER_CLIENT - 1), 5000}
    assert sight.session.requests_bytes == 0


async def test_a_viewer_leaves_in_mid_call(sight: Sight) -> None:
    """The calls of a viewer that leaves are given up, and nothing of it stays."""
    gate = Gate()
    await sight.robot.create_service("/slow", ADD, gate)
    viewer = await sight.viewer()
    viewer.send_binary(call((await viewer.service("/slow"))["id"], 1, addends(1)))
    await until(lambda: gate.seen)
    viewer.abort()
    await until(lambda: not sight.server.sessions)
    gate.open.set()


async def test_the_server_stops_in_mid_call(sight: Sight) -> None:
    """Calls under way are answered before the connection is closed."""
    gate = Gate()
    await sight.robot.create_service("/slow", ADD, gate)
    viewer = await sight.viewer()
    viewer.send_binary(call((await viewer.service("/slow"))["id"], 1, addends(1)))
    await until(lambda: gate.seen)
    stopping = asyncio.create_task(sight.server.close())
    assert "stops" in (await viewer.op("serviceCallFailure"))["message"]
    assert (await viewer.closed())[0] == 1001
    await stopping
    gate.open.set()


async def test_answers_that_are_not_read(sight: Sight) -> None:
    """Large answers that a viewer does not read are not kept without end: those after them fail."""
    large = b"\0\1\0\0\1\0\0\0" + struct.pack("<I", 6 << 20) + b"x" * ((6 << 20) - 1) + b"\0"

    async def talk(_: Request) -> bytes:
        return large

    await sight.robot.create_service("/talk", TEXT, talk)
    viewer = await sight.viewer(receive_bytes=1024)
    number = (await viewer.service("/talk"))["id"]
    ask = sight.registry.codec(f"{TEXT}_Request").encode({})
    for call_number in range(20):
        viewer.send_binary(call(number, call_number, ask))
    session = sight.session
    await until(lambda: session.fault_log.counts["service call", ""] > 0)
    assert session.sender.answers_bytes <= 24 << 20
    answered = 0
    while answered < 20:
        got = await viewer.take()
        answered += isinstance(got, bytes) or got["op"] == "serviceCallFailure"
    assert session.sender.answers_bytes == 0
