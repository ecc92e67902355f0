"""ropeway.networks.rosbridge.link.calls: operations with a body, between gateways and to plain peers."""

from __future__ import annotations

import asyncio
import json
import os
from collections.abc import AsyncIterator
from contextlib import AsyncExitStack
from typing import Any

import cbor2
import pytest

from ropeway.errors import DecodeError, MessageTooBig, OutboxFull, RopewayError
from ropeway.networks.rosbridge.link.calls import OP_CHANNELS, WAITING_LIMIT_BYTES
from ropeway.networks.rosbridge.link.peer import Peer
from ropeway.networks.rosbridge.protocol import ops
from ropeway.networks.rosbridge.protocol.codec import decode_value
from ropeway.networks.rosbridge.protocol.dialect import ROPEWAY_SUBPROTOCOL
from ropeway.networks.rosbridge.protocol.records import RecordWriter
from tests.networks.rosbridge.link.test_peer import REGISTRY, Link, Setting, sample
from tests.support.messages import STRING, text
from tests.support.until import until

pytestmark = pytest.mark.jumping

CODEC = REGISTRY.codec(STRING)


@pytest.fixture
async def setting() -> AsyncIterator[Setting]:
    async with AsyncExitStack() as stack:
        made = Setting(stack)
        await made.start()
        yield made


@pytest.fixture
async def link(setting: Setting) -> Link:
    """Two gateways that have said hello."""
    made = await setting.link()
    made.far.hello("far", "far")
    await until(lambda: made.near_handler.controls)
    return made


def call(id: Any = "1") -> ops.CallService:
    return ops.CallService(id=id, service="/s", args=None)


async def come(link: Link, count: int) -> list[Any]:
    await until(lambda: len(link.far_handler.operations) >= count)
    return link.far_handler.operations


@pytest.mark.parametrize("encoding", ["none", "png", "cbor", "cbor-raw", "zip", "rawzip", "zstd", "auto", "odd"])
@pytest.mark.parametrize("size", [10, 3_000_000])
async def test_encodings(link: Link, encoding: str, size: int) -> None:
    """A body comes back bit by bit in every encoding, and the operation names the one that was used."""
    payload = text(os.urandom(size // 2).hex())
    link.near.send_op(call(), payload=payload, codec=CODEC, encoding=encoding)
    (op,) = await come(link, 1)
    assert isinstance(op, ops.CallService)
    assert (op.id, op.service) == ("1", "/s")
    assert op.compression == {"auto": "cbor-raw", "png": "none", "odd": "none"}.get(encoding, encoding)
    assert decode_value(op.args, op.compression, CODEC) == payload


async def test_a_slow_link_compresses(link: Link) -> None:
    """On a slow link what is large goes compressed, unless told otherwise."""
    pace = link.near.connection.flow.pace
    pace.bytes_per_s = 100_000.0
    for size in (1000, 50_000):
        link.near.send_op(call(), payload=text("x" * size))
    assert [op.compression for op in await come(link, 2)] == ["cbor-raw", "zstd"]


async def test_answers(link: Link) -> None:
    """Responses, goals, feedback, results and operations without a body take the same way."""
    told = [
        (ops.ServiceResponse(id="1", service="/s", values=None, result=True), "values"),
        (ops.SendActionGoal(id="2", action="/a", action_type="p/action/A", args=None, feedback=True), "args"),
        (ops.ActionFeedback(id="2", action="/a", values=None), "values"),
        (ops.ActionResult(id="2", action="/a", values=None, status=4, result=True), "values"),
    ]
    for op, field in told:
        link.near.send_op(op, payload=text("body"), field=field)  # type: ignore[arg-type]
    link.near.send_op(ops.CancelActionGoal(id="2", action="/a"))
    link.near.send_op({"op": "accepted", "id": "2"})
    come_ = await come(link, 5)
    assert [op.op for op in come_] == [op.op for op, _ in told] + ["cancel_action_goal"]
    for op, (_, field) in zip(come_, told, strict=False):
        assert getattr(op, field) == text("body")
    await until(lambda: link.far_handler.controls)
    assert link.far_handler.controls == [{"op": "accepted", "id": "2"}]
    assert link.far.connection.frames_in <= 7


async def test_one_call_does_not_overtake_itself(link: Link) -> None:
    """A small operation waits behind a large one of the same id; those of other ids go before it."""
    big = text("x" * 6_000_000)
    link.near.send_op(call("big"), payload=big)
    await asyncio.sleep(0)
    await asyncio.sleep(0)
    link.near.send_op(ops.CancelActionGoal(id="big", action="/a"))
    link.near.send_op(ops.CancelActionGoal(id="other", action="/a"), priority=99)
    link.near.send_op(ops.CancelActionGoal(id="small", action="/a"))
    come_ = await come(link, 4)
    assert [op.id for op in come_] == ["small", "big", "big", "other"]
    assert come_[1].op == "call_service"


async def test_commands_overtake_large_answers(link: Link) -> None:
    """Urgent topics and small calls go between the parts of a large answer."""
    link.near.send_op(call("big"), payload=text("x" * 6_000_000))
    await asyncio.sleep(0)
    await asyncio.sleep(0)
    link.channel(1, priority=0).put(sample(text("stop")))
    link.near.send_op(call("small"), payload=text("x"))
    await link.arrived(1)
    come_ = await come(link, 2)
    assert [op.id for op in come_] == ["small", "big"]


async def test_without_hello(setting: Setting) -> None:
    """To a gateway that does not read calls in records they go as text."""
    link = await setting.link()
    link.near.send_op(call(), payload=text("x"), codec=CODEC)
    link.near.send_op(ops.CancelActionGoal(id="1", action="/a"))
    first, second = await come(link, 2)
    assert isinstance(first, ops.CallService)
    assert (first.args, first.compression) == ({"data": "x"}, None)
    assert second.op == "cancel_action_goal"


async def test_plain_peers(setting: Setting) -> None:
    """A plain peer gets JSON text for what it has no encoding for, large ones after small ones."""
    client, far, _ = await setting.client()
    payload = text("x" * 2_000_000)
    far.send_op(call("1"), payload=payload, codec=CODEC, encoding="zstd")
    far.send_op(call("2"), payload=text("y"), codec=CODEC, encoding="zip")
    second, first = await client.json(), await client.json()
    assert first == {"op": "call_service", "id": "1", "service": "/s", "args": {"data": "x" * 2_000_000}}
    assert second == {"op": "call_service", "id": "2", "service": "/s", "args": {"data": "y"}}
    assert not far.sender.outbox.bytes


async def test_fragments(setting: Setting) -> None:
    """A plain peer that asked for fragments gets a long answer in them, and the next one after them."""
    client, far, _ = await setting.client()
    far.send_op(call("1"), payload=text("x" * 100), codec=CODEC, fragment_size=80)
    far.send_op(call("2"), payload=text("y"), codec=CODEC)
    frames = [await client.json() for _ in range(4)]
    assert [f["op"] for f in frames] == ["fragment"] * 3 + ["call_service"]
    assert json.loads("".join(f["data"] for f in frames[:3]))["id"] == "1"
    assert frames[-1]["id"] == "2"


async def test_what_cannot_be_encoded(setting: Setting) -> None:
    """A payload that is not of its type is an error at once, or, where a thread encodes it, told by a callback."""
    _, far, _ = await setting.client()
    with pytest.raises(DecodeError):
        far.send_op(call(), payload=b"\0\1\0\0\xff\xff\xff\xff", codec=CODEC)
    with pytest.raises(DecodeError, match="not known"):
        far.send_op(call(), payload=text("x"))
    told: list[RopewayError] = []
    far.send_op(call(), payload=b"\0\1\0\0" + b"\xff" * 2_000_000, codec=CODEC, on_unsent=told.append)
    far.send_op(call(), payload=b"\0\1\0\0" + b"\xff" * 2_000_000, codec=CODEC)
    await until(lambda: told and not far.sender.outbox.bytes)
    assert isinstance(told[0], DecodeError)


async def test_too_much(link: Link) -> None:
    """What the peer would not take, and what is too much for the link, is refused with the figures."""
    with pytest.raises(MessageTooBig, match="8388608"):
        link.near.send_op(call(), payload=bytes(9 << 20))
    link.far.connection.pause_reading()
    payload = text("x" * (7 << 20))
    with pytest.raises(OutboxFull, match=str(WAITING_LIMIT_BYTES)):
        for _ in range(20):
            link.near.send_op(call(), payload=payload)
    link.near.send_op(call("small"))  # a refusal still fits
    link.far.connection.resume_reading()
    await until(lambda: any(op.id == "small" for op in link.far_handler.operations))


async def test_answers_nobody_reads(link: Link) -> None:
    """A peer that reads nothing is closed before answers without a body fill the memory."""
    link.far.connection.pause_reading()
    values = "x" * (4 << 20)
    for _ in range(40):
        link.near.send_op(ops.ServiceResponse(id="1", service="/s", values=values, result=False))
        await asyncio.sleep(0)
    assert await link.near.connection.wait_closed() == (1008, "answers are not read")
    link.near.send_op(call(), payload=text("x"))  # nothing happens


async def test_hostile_records(setting: Setting) -> None:
    """Records that are no operations are complained of, and the connection goes on."""
    client, far, handler = await setting.client(subprotocol=ROPEWAY_SUBPROTOCOL)
    writer = RecordWriter()
    for body in (b"", b"\xff", b"\x81" * 300, cbor2.dumps([1]), cbor2.dumps({"op": []}), cbor2.dumps({1: 2})):
        out: list[bytes] = []
        writer.message(out, OP_CHANNELS[1], 2, body, bytes(16), 0, 0)
        client.send_binary(b"".join(out))
    out = []
    writer.message(out, OP_CHANNELS[7], 99, cbor2.dumps({"op": "call_service", "service": "/s"}), bytes(16), 0, 0)
    writer.message(out, 1, 3, b"topic", bytes(16), 1, 1)
    client.send_binary(b"".join(out))
    await until(lambda: handler.operations and handler.arrivals)
    assert far.fault_log.counts == {("frame", ""): 4, ("operation", ""): 2}
    client.abort()


async def test_the_end(link: Link) -> None:
    """What waits when the connection goes is dropped."""
    link.far.connection.pause_reading()
    for _ in range(5):
        link.near.send_op(call(), payload=text("x" * 7_000_000))
    link.near.connection.abort("gone")
    await until(lambda: link.near_handler.ends)
    assert isinstance(link.near, Peer)
    assert not link.near.sender.outbox.bytes
