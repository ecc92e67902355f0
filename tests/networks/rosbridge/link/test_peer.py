"""ropeway.networks.rosbridge.link.peer: two ends of a link over real sockets, in both dialects."""

from __future__ import annotations

import asyncio
import json
import os
import random
import time
from collections.abc import AsyncIterator, Container, Mapping, Sequence
from contextlib import AsyncExitStack
from typing import Any

import pytest

from ropeway.delivery.outbox import Lost
from ropeway.errors import DecodeError, InvalidDefinition, UnknownType
from ropeway.graph.base import Sample
from ropeway.listener.connection import Limits
from ropeway.listener.websocket import connect, listen
from ropeway.networks.rosbridge.link.peer import Channel, Peer
from ropeway.networks.rosbridge.protocol import ops
from ropeway.networks.rosbridge.protocol.codec import ENCODING_NUMBERS
from ropeway.networks.rosbridge.protocol.dialect import ROPEWAY, ROPEWAY_SUBPROTOCOL
from ropeway.networks.rosbridge.protocol.records import HEADER_BYTES, Arrival
from ropeway.types import TypeRegistry
from tests.support.messages import STRING, text
from tests.support.until import PATIENCE_S, until
from tests.support.websocket import Client, frame

pytestmark = pytest.mark.jumping

LIMITS = Limits(ping_interval_s=None, max_message_bytes=8 << 20)
ORIGIN = b"o" * 16
REGISTRY = TypeRegistry()


def sample(payload: bytes, seq: int = 1, type: str = STRING) -> Sample:
    return Sample(payload, type, time.time_ns(), ORIGIN, seq)


class Handler:
    """Keeps what a peer tells."""

    def __init__(self) -> None:
        self.operations: list[ops.Op] = []
        self.controls: list[Mapping[str, Any]] = []
        self.arrivals: list[Arrival] = []
        self.ends: list[tuple[int, str]] = []
        self.error: Exception | None = None
        self.channels: Container[int] = range(1 << 16)

    def operation(self, op: ops.Op) -> None:
        self.operations.append(op)
        if self.error is not None:
            raise self.error

    def control(self, message: Mapping[str, Any]) -> None:
        self.controls.append(message)
        if self.error is not None:
            raise self.error

    def arrived(self, channel: int, arrivals: Sequence[Arrival]) -> None:
        assert all(a.channel == channel for a in arrivals)
        self.arrivals.extend(arrivals)

    def takes(self, channel: int) -> bool:
        return channel in self.channels

    def lost(self, code: int, reason: str) -> None:
        self.ends.append((code, reason))


class Link:
    """``near`` connected to ``far``."""

    def __init__(self) -> None:
        self.near_handler, self.far_handler = Handler(), Handler()
        self.near: Peer
        self.far: Peer

    def channel(self, number: int = 1, encoding: str = "cbor-raw", *, priority: int = 4, **options: Any) -> Channel:
        settings = {"topic": f"/t{number}", "type": STRING, "depth": 10, "lifespan_s": None, **options}
        topic, type = settings.pop("topic"), settings.pop("type")
        return self.near.open_channel(number, topic, type, encoding=encoding, priority=priority, **settings)

    async def arrived(self, count: int, timeout_s: float = PATIENCE_S) -> list[Arrival]:
        await until(lambda: len(self.far_handler.arrivals) >= count, timeout_s)
        return self.far_handler.arrivals


class Setting:
    """Makes links and takes them down."""

    def __init__(self, stack: AsyncExitStack) -> None:
        self.stack = stack
        self.port = 0
        self.far_ends: list[tuple[Peer, Handler]] = []

    async def start(self) -> None:
        def accept(connection: Any) -> None:
            handler = Handler()
            self.far_ends.append((Peer(connection, REGISTRY, handler), handler))

        server = await listen("127.0.0.1", 0, accept, limits=LIMITS, subprotocols=(ROPEWAY_SUBPROTOCOL,))
        self.port = server.port
        self.stack.push_async_callback(server.close)
        self.stack.push_async_callback(self._end)

    async def _end(self) -> None:
        for peer, _ in self.far_ends:
            peer.connection.abort("the test is over")
        await until(lambda: all(peer.connection.closed for peer, _ in self.far_ends))

    async def link(self, *, plain: bool = False) -> Link:
        made = Link()
        connection = await connect(
            f"ws://127.0.0.1:{self.port}", limits=LIMITS, subprotocols=() if plain else (ROPEWAY_SUBPROTOCOL,)
        )
        made.near = Peer(connection, REGISTRY, made.near_handler)
        await until(lambda: self.far_ends)
        made.far, made.far_handler = self.far_ends[-1]
        return made

    async def client(self, **options: Any) -> tuple[Client, Peer, Handler]:
        count = len(self.far_ends)
        client = await self.stack.enter_async_context(Client(self.port, **options))
        await until(lambda: len(self.far_ends) > count)
        return (client, *self.far_ends[-1])


@pytest.fixture
async def setting() -> AsyncIterator[Setting]:
    async with AsyncExitStack() as stack:
        made = Setting(stack)
        await made.start()
        yield made


@pytest.fixture
async def link(setting: Setting) -> Link:
    return await setting.link()


# ── messages between gateways ──────────────────────────────────────────────────────────────────────────────────────


async def test_messages(link: Link) -> None:
    """Messages of several channels arrive whole, in order, with origin, sequence number and time."""
    channels = [link.channel(n) for n in (1, 2, 65527)]
    sent = {c.number: [sample(text(f"{c.number} {i}"), i) for i in range(5)] for c in channels}
    for i in range(5):
        for channel in channels:
            channel.put(sent[channel.number][i])
    arrivals = await link.arrived(15)
    for number, samples in sent.items():
        got = [a for a in arrivals if a.channel == number]
        assert [(a.body, a.seq, a.stamp_ns, a.origin) for a in got] == [
            (s.payload, s.seq, s.stamp_ns, s.origin) for s in samples
        ]
    assert [c.sent for c in channels] == [5, 5, 5]
    assert channels[0].sent_bytes == sum(len(s.payload) for s in sent[1])


@pytest.mark.parametrize("encoding", ["none", "png", "cbor", "cbor-raw", "zip", "rawzip", "zstd", "auto"])
@pytest.mark.parametrize("size", [10, 3_000_000])
async def test_encodings(link: Link, encoding: str, size: int) -> None:
    """Every encoding brings a message back bit by bit, small ones and those that a thread encodes in parts."""
    channel = link.channel(1, encoding)
    payload = text(os.urandom(size // 2).hex())
    channel.put(sample(payload))
    (arrival,) = await link.arrived(1)
    assert link.far.decode(arrival, REGISTRY.codec(STRING)) == payload


async def test_urgent_messages_overtake(link: Link) -> None:
    """A big message goes in parts, and an urgent one that comes later arrives before it."""
    bulk, command = link.channel(1, priority=7), link.channel(2, priority=0)
    big = text("x" * 6_000_000)
    bulk.put(sample(big))
    await asyncio.sleep(0)
    await asyncio.sleep(0)
    command.put(sample(text("stop")))
    first, second = await link.arrived(2)
    assert (first.channel, first.body) == (2, text("stop"))
    assert second.body == big


async def test_a_busy_encoder_holds_nobody_up(link: Link) -> None:
    """While a thread encodes a big message, other topics go on, those of its own lane, too."""
    slow, fast, same = link.channel(1, "png", priority=3), link.channel(2, priority=5), link.channel(3, priority=3)
    slow.put(sample(text(os.urandom(1_500_000).hex())))
    fast.put(sample(text("fast")))
    same.put(sample(text("same")))
    arrivals = await link.arrived(3)
    assert [a.channel for a in arrivals] == [3, 2, 1]


async def test_a_withdrawn_channel_lets_its_lane_go_on(link: Link) -> None:
    """A channel that is closed while its message is being encoded or sent does not hold up its lane."""
    for encoding, number in (("png", 1), ("cbor-raw", 3)):
        closing, waiting = link.channel(number, encoding), link.channel(number + 1)
        closing.put(sample(text("x" * 6_000_000)))
        await asyncio.sleep(0)
        await asyncio.sleep(0)
        waiting.put(sample(text("after")))
        closing.close()
        closing.close()
        closing.put(sample(text("too late")))
        assert closing.queue.lost[Lost.UNSENT] >= 1
        await until(lambda n=number: any(a.channel == n + 1 for a in link.far_handler.arrivals))
        assert not [a for a in link.far_handler.arrivals if a.channel == number]
    again = link.channel(3)
    again.put(sample(text("new life of a number")))
    arrivals = await link.arrived(3)
    assert arrivals[-1].body == text("new life of a number")


async def test_what_cannot_be_encoded(link: Link) -> None:
    """A message that is not of its type is counted as lost, and the next one goes out."""
    channel = link.channel(1, "cbor")
    plain = link.channel(2, "png")
    for one in (channel, plain):
        one.put(sample(b"\0\1\0\0\xff\xff\xff\xff"))
        one.put(sample(b""))
        one.put(sample(text("good")))
    await link.arrived(2)
    assert channel.queue.lost == plain.queue.lost == {Lost.ENCODE: 2}
    assert link.near.fault_log.counts == {("message", "/t1"): 2, ("message", "/t2"): 2}


async def test_unknown_types(setting: Setting) -> None:
    """Raw encodings need no definition between gateways; the others say which one is missing."""
    link = await setting.link()
    for encoding in ("auto", "cbor-raw", "rawzip", "zstd"):
        link.channel(1, encoding, type="my_msgs/msg/Own").close()
    for encoding in ("none", "png", "cbor", "zip"):
        with pytest.raises(UnknownType, match="my_msgs/msg/Own"):
            link.channel(1, encoding, type="my_msgs/msg/Own")
    plain = await setting.link(plain=True)
    for encoding in ("none", "cbor"):
        with pytest.raises(UnknownType):
            plain.channel(1, encoding, type="my_msgs/msg/Own")
    plain.channel(1, "cbor-raw", type="my_msgs/msg/Own")


async def test_too_big(link: Link) -> None:
    """A message above the limit of the receiver is refused with its channel, and the connection lives on."""
    channel = link.channel(1)
    channel.put(sample(text("x" * 9_000_000)))
    await until(lambda: link.near_handler.controls)
    (refused,) = link.near_handler.controls
    assert (refused["op"], refused["channel"]) == ("refused", 1)
    assert str(8 << 20) in refused["reason"]
    assert link.far.fault_log.counts == {("size", "channel 1"): 1}
    channel.put(sample(text("small")))
    assert (await link.arrived(1))[0].body == text("small")


async def test_the_end(link: Link) -> None:
    """When the connection goes, what waits is lost and counted, and both handlers are told."""
    channel = link.channel(1)
    far_channel = link.far.open_channel(1, "/back", STRING, encoding="png", priority=4, depth=10, lifespan_s=None)
    far_channel.put(sample(text("x" * 3_000_000)))
    await asyncio.sleep(0)
    await asyncio.sleep(0)
    far_channel.put(sample(text("waits")))
    link.far.connection.abort("pulled")
    await until(lambda: link.near_handler.ends and link.far_handler.ends)
    assert link.far_handler.ends == [(1006, "pulled")]
    assert link.near.sender.outbox.messages == link.far.sender.outbox.messages == 0
    assert far_channel.closed
    assert far_channel.queue.lost[Lost.UNSENT] == 1
    channel.put(sample(text("x")))
    assert channel.queue.lost == {Lost.UNSENT: 1}
    link.near.send({"op": "hello"})


# ── control, the clock ─────────────────────────────────────────────────────────────────────────────────────────────


async def test_control_messages(link: Link) -> None:
    """Messages of the dialect go to the handler, whose complaint about one of them costs no other."""
    link.near.send({"op": "demand", "channel": 1, "count": 2})
    await until(lambda: link.far_handler.controls)
    assert link.far_handler.controls == [{"op": "demand", "channel": 1, "count": 2}]
    link.far_handler.error = InvalidDefinition("a/msg/B", "it is empty")
    link.near.send({"op": "adopted", "definition": ""})
    link.near.send(ops.Unsubscribe(topic="/x"))
    await until(lambda: link.far_handler.operations)
    assert link.far.fault_log.counts == {("adopted", ""): 1, ("unsubscribe", "/x"): 1}
    assert not link.far.connection.closed


async def test_dialects_are_apart(setting: Setting) -> None:
    """A plain client cannot speak the dialect of gateways."""
    client, peer, handler = await setting.client()
    client.send({"op": "hello", "gateway": "x"})
    client.send({"op": "ping", "t": 1})
    await until(lambda: peer.fault_log.total == 2)
    assert handler.controls == []
    assert peer.fault_log.counts == {("operation", ""): 2}


async def test_clock(setting: Setting) -> None:
    """The difference of the clocks is measured through the answers to pings, and followed when a clock is set."""
    client, peer, _ = await setting.client(subprotocol=ROPEWAY_SUBPROTOCOL)
    ahead_ns = 5_000_000_000
    assert peer.clock_offset_ns is None

    def off() -> int:
        assert peer.clock_offset_ns is not None
        return abs(peer.clock_offset_ns - ahead_ns)

    async def answer() -> None:
        peer.ping()
        asked = await client.json()
        assert asked["op"] == "ping"
        client.send({"op": "pong", "t": asked["t"], "r": time.time_ns() + ahead_ns})
        before = peer.rtt_s
        await until(lambda: peer.rtt_s != before)

    for _ in range(5):
        await answer()
    for _ in range(100):  # an answer that a busy machine delays tells less; one of many comes in time
        if off() < 20_000_000 and (peer.rtt_s or 0) < 0.1:
            break
        await answer()
    assert off() < 20_000_000
    assert peer.rtt_s is not None
    assert 0 < peer.rtt_s < 0.1
    for odd in (None, "1", 1e300, 2**63, -1, True, {"x": 1}):
        client.send({"op": "pong", "t": odd, "r": odd})
        client.send({"op": "ping", "t": odd})
        assert (await client.json())["t"] == odd
    assert off() < 20_000_000
    ahead_ns = -3_000_000_000
    await answer()
    assert off() < 20_000_000


async def test_answers_that_are_not_read(setting: Setting) -> None:
    """A peer that makes us answer and does not read is closed with 1008, before it costs much memory."""
    client, peer, handler = await setting.client()
    answer = {"op": "service_response", "service": "/x", "values": "x" * 1_000_000, "result": False}
    for _ in range(200):
        peer.send(answer)
    assert peer.connection.unsent_bytes < 64 << 20
    await until(lambda: handler.ends)
    assert handler.ends == [(1008, "answers are not read")]
    assert (await client.closed())[0] in (1006, 1008)


# ── plain rosbridge ────────────────────────────────────────────────────────────────────────────────────────────────


async def test_plain_messages(setting: Setting) -> None:
    """A plain peer gets frames of rosbridge; auto is none for it."""
    client, peer, _ = await setting.client()
    for number, encoding in enumerate(("auto", "none", "cbor-raw")):
        channel = peer.open_channel(number, "/t", STRING, encoding=encoding, priority=4, depth=10, lifespan_s=None)
        channel.put(sample(text("hi")))
        got = await client.receive()
        assert got.text is (encoding != "cbor-raw")
        message = got.json if got.text else got.cbor
        assert message["msg"] == {"data": "hi"} or message["msg"]["bytes"] == text("hi")


async def test_a_slow_plain_peer_gets_the_newest(setting: Setting) -> None:
    """Of a topic with big messages, a peer that reads slowly gets the newest; the displaced ones are counted."""
    client, peer, _ = await setting.client(receive_bytes=65536)
    channel = peer.open_channel(1, "/t", STRING, encoding="none", priority=4, depth=10, lifespan_s=None)
    for i in range(200):
        channel.put(sample(text(f"{i} " + "x" * 500_000)))
        await asyncio.sleep(0)
    assert peer.sender.outbox.messages == 1
    assert peer.connection.unsent_bytes < 4 << 20
    got: list[int] = []
    while not got or got[-1] < 199:
        got.append(int((await client.json())["msg"]["data"].split()[0]))
    assert got == sorted(got)
    assert channel.queue.lost == {Lost.REPLACED: 200 - len(got)}
    assert len(got) < 100


async def test_urgent_messages_between_fragments(setting: Setting) -> None:
    """The fragments of a text go out as the link takes them, in order and with nothing between."""
    client, peer, _ = await setting.client()
    channel = peer.open_channel(1, "/t", STRING, encoding="none", priority=4, depth=10, lifespan_s=None)
    channel.fragment_size = 1000
    long = "x" * 3_000_000
    channel.put(sample(text(long)))
    channel.put(sample(text("next")))
    parts = []
    while True:
        message = await client.json()
        if message["op"] != "fragment":
            break
        parts.append(message)
    assert json.loads("".join(p["data"] for p in parts))["msg"]["data"] == long
    assert message["msg"]["data"] == "next"


async def test_operations_in_fragments(setting: Setting) -> None:
    """Fragments are put together on this side of the handler; what is wrong with them is a complaint."""
    client, peer, handler = await setting.client()
    client.send({"op": "fragment", "id": "1", "data": '{"op":"unsub', "num": 0, "total": 2})
    client.send({"op": "fragment", "id": "1", "data": 'scribe","topic":"/x"}', "num": 1, "total": 2})
    await until(lambda: handler.operations)
    assert handler.operations == [ops.Unsubscribe(topic="/x")]
    client.send({"op": "fragment", "id": "2", "data": "no json", "num": 0, "total": 1})
    client.send({"op": "fragment", "id": "3", "data": "x", "num": 5, "total": 2})
    client.send({"op": "fragment", "data": "x", "num": 0, "total": 2})
    await until(lambda: peer.fault_log.total == 3)
    client.send('{"op":"unsubscribe"')
    client.send({"op": "fragment", "id": "4", "data": '{"op":"unsubscribe","topic":"/y"}', "num": 0, "total": 1})
    await until(lambda: len(handler.operations) == 2)


async def test_a_handler_that_objects(setting: Setting) -> None:
    """What the handler says against an operation is a complaint with its topic, and the rest of the frame counts."""
    client, peer, handler = await setting.client()
    handler.error = DecodeError(STRING, "none", "it is not")
    client.send('{"op":"publish","topic":"/a","msg":{}}{"op":"publish","topic":"/b","msg":{}}')
    await until(lambda: len(handler.operations) == 2)
    assert peer.fault_log.counts == {("publish", "/a"): 1, ("publish", "/b"): 1}


# ── records that are wrong ─────────────────────────────────────────────────────────────────────────────────────────


@pytest.mark.parametrize(
    "data",
    [
        b"x",
        bytes(HEADER_BYTES),
        b"\x01\x03\x01\x00" + bytes(4) + b"\xff\xff\xff\xff" + bytes(16),
        b"\x02" + bytes(7) + b"\x02" + bytes(19) + b"xx",
        b"\x04" + bytes(7) + b"\x01" + bytes(19) + b"x",
        random.Random(7).randbytes(500),
    ],
)
async def test_broken_records(setting: Setting, data: bytes) -> None:
    """A binary frame that holds no records is a complaint; the connection and what follows live on."""
    client, peer, handler = await setting.client(subprotocol=ROPEWAY_SUBPROTOCOL)
    client.raw(frame(2, data))
    client.send({"op": "demand", "channel": 1, "count": 1})
    await until(lambda: handler.controls)
    assert not handler.arrivals
    assert peer.fault_log.counts == {("frame", ""): 1}


async def test_unknown_encoding(link: Link) -> None:
    """A record in an encoding that does not exist is no message."""
    arrival = Arrival(1, 200, b"", ORIGIN, 1, 0)
    with pytest.raises(DecodeError, match="encoding 200"):
        link.far.decode(arrival, None)
    assert link.far.dialect is ROPEWAY
    assert ENCODING_NUMBERS["zstd"] < 200


def fragment(inner: Mapping[str, Any], id: str) -> dict[str, Any]:
    """A text in one fragment."""
    return {"op": "fragment", "id": id, "data": json.dumps(inner), "num": 0, "total": 1}


async def test_fragments_in_fragments(setting: Setting) -> None:
    """An operation may come in fragments; fragments within fragments are refused, and the connection goes on."""
    client, peer, handler = await setting.client()
    op = {"op": "unsubscribe", "topic": "/a"}
    client.send(fragment(op, "1"))
    await until(lambda: len(handler.operations) == 1)
    client.send(fragment(fragment(op, "2"), "3"))
    client.send(fragment(op, "4"))
    await until(lambda: len(handler.operations) == 2)
    assert peer.fault_log.counts["fragment", ""] == 1
