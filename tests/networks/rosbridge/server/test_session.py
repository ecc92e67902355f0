"""ropeway.networks.rosbridge.server.session: conversations with a plain rosbridge client, operation by operation."""

from __future__ import annotations

import asyncio
import base64
import json
import struct
import time
import zlib
from types import SimpleNamespace
from typing import Any

import pytest

from ropeway.networks.rosbridge.protocol.dialect import ROPEWAY_SUBPROTOCOL
from ropeway.networks.rosbridge.server import topic_channels
from ropeway.qos import LATCHED, SENSOR_DATA, QoS
from tests.support.clock import Stopwatch
from tests.support.inbox import Inbox
from tests.support.messages import STRING, sample, text
from tests.support.place import Place
from tests.support.until import PATIENCE_S, until
from tests.support.websocket import BINARY, Client, ClosedByServer

CHATTER = {"op": "advertise", "topic": "/chatter", "type": "std_msgs/String"}


def said(value: str, topic: str = "/chatter", **more: Any) -> dict[str, Any]:
    return {"op": "publish", "topic": topic, "msg": {"data": value}, **more}


def heard(value: str, topic: str = "/chatter") -> dict[str, Any]:
    return {"op": "publish", "topic": topic, "msg": {"data": value}}


def listen(topic: str = "/chatter", **more: Any) -> dict[str, Any]:
    return {"op": "subscribe", "topic": topic, "type": "std_msgs/String", **more}


async def reader(place: Place, topic: str = "/chatter", qos: QoS | None = None) -> Inbox:
    inbox = Inbox()
    await place.robot.create_subscription(topic, STRING, qos or QoS(depth=100), inbox)
    return inbox


async def wait_for_network(place: Place, topic: str = "/chatter", kind: str = "publishers") -> None:
    await until(lambda: topic in place.robot.topics() and getattr(place.robot.topics()[topic], kind))


def client_views(place: Place) -> list[str]:
    """Those who use the graph, the server itself left out."""
    return [view.user for view in place.hub.views if view.user not in ("server", "rosapi")]


def publishers(place: Place, topic: str = "/chatter") -> list[QoS]:
    found = place.robot.topics().get(topic)
    return [p.qos for p in found.publishers] if found else []


def unpng(data: str) -> tuple[int, int, bytes]:
    """Width, height and the pixel bytes of a rosbridge PNG, read chunk by chunk."""
    raw = base64.b64decode(data, validate=True)
    assert raw[:8] == b"\x89PNG\r\n\x1a\n"
    at, header, packed = 8, b"", b""
    while at < len(raw):
        (size,) = struct.unpack_from("!I", raw, at)
        kind, body = raw[at + 4 : at + 8], raw[at + 8 : at + 8 + size]
        assert zlib.crc32(kind + body) == struct.unpack_from("!I", raw, at + 8 + size)[0]
        header = body if kind == b"IHDR" else header
        packed += body if kind == b"IDAT" else b""
        at += size + 12
    width, height, depth, color = struct.unpack_from("!IIBB", header)
    assert (depth, color) == (8, 2)  # RGB, no alpha: what a browser's canvas gives back unchanged
    rows = zlib.decompress(packed)
    stride = 3 * width + 1
    assert len(rows) == height * stride
    lines, above = [], bytes(3 * width)
    for i in range(height):
        kind, line = rows[i * stride], bytearray(rows[i * stride + 1 : (i + 1) * stride])
        assert kind in (0, 2), kind
        if kind == 2:
            line = bytearray((a + b) & 255 for a, b in zip(line, above, strict=True))
        above = bytes(line)
        lines.append(above)
    return width, height, b"".join(lines)


# ── advertise, unadvertise, publish ────────────────────────────────────────────────────────────────────────────────


@pytest.mark.parametrize("type", ["std_msgs/String", "std_msgs/msg/String", "/std_msgs//String/"])
async def test_publishes(place: Place, type: str) -> None:
    """What a client publishes arrives on the network in order; a type has two or three parts."""
    inbox = await reader(place)
    client = await place.client()
    client.send({**CHATTER, "type": type, "id": "advertise:/chatter:1"})
    for i in range(5):
        client.send(said(str(i), id=f"publish:/chatter:{i}", latch=False))
    await inbox.wait(5)
    assert inbox.payloads == [text(str(i)) for i in range(5)]
    await client.nothing()


@pytest.mark.parametrize("advertised", [True, False])
async def test_repeated_ids(place: Place, advertised: bool) -> None:
    """A message whose id came before is dropped for a client that says that its ids are unique, and for no other."""
    inbox = await reader(place)
    unique: dict[str, Any] = {"ropeway": {"unique_ids": True}}
    client, plain = await place.client(), await place.client()
    client.send({**CHATTER, **(unique if advertised else {})})
    plain.send(CHATTER)
    for id in ("a", "a", "b", "a", 7, 7):
        client.send(said(str(id), id=id, **({} if advertised else unique)))
    client.send(said("none"))
    client.send(said("none"))
    await inbox.wait(5)
    plain.send(said("a", id="a"))
    plain.send(said("a", id="a"))
    await inbox.wait(7)
    assert inbox.payloads == [text(word) for word in ("a", "b", "7", "none", "none", "a", "a")]


async def test_repeated_ids_of_rosgw(place: Place) -> None:
    """A gateway of the older kind means by an id that a message is the same: it is delivered once."""
    inbox = await reader(place)
    client = await place.client()
    client.send({**CHATTER, "compression": "cbor"})
    for id in ("1", "1", "2"):
        client.send(said(id, id=id))
    await inbox.wait(2)
    client.send(said("3", id="3"))
    await inbox.wait(3)
    assert inbox.payloads == [text("1"), text("2"), text("3")]


async def test_relative_names(place: Place) -> None:
    """A relative name is the absolute one on the network, and is told back as the client gave it."""
    inbox = await reader(place)
    talker, listener = await place.client(), await place.client()
    listener.send(listen("chatter"))
    await listener.done()
    talker.send({**CHATTER, "topic": "chatter"})
    talker.send(said("hi", "chatter"))
    await inbox.wait(1)
    assert await listener.json() == heard("hi", "chatter")


async def test_own_echo(place: Place) -> None:
    """A client hears its own messages on a topic that it reads, once, under either spelling of the name."""
    client = await place.client()
    client.send(CHATTER)
    client.send(listen())
    client.send(listen("chatter"))
    client.send(said("me"))
    got = [await client.json(), await client.json()]
    assert sorted(m["topic"] for m in got) == ["/chatter", "chatter"]
    await client.nothing()


async def test_advertises_by_publishing(place: Place) -> None:
    """A publish with a type advertises the topic; its id then serves to withdraw it."""
    client = await place.client()
    client.send(said("1", type="std_msgs/String", id="p1", queue_size=7))
    await client.done()
    assert [q.depth for q in publishers(place)] == [7]
    client.send({"op": "unadvertise", "topic": "/chatter", "id": "p1"})
    await until(lambda: not publishers(place))


async def test_infers_the_type_of_a_publish(place: Place) -> None:
    """A publish without a type takes the type that the topic has on the network."""
    inbox = await reader(place)
    client = await place.client()
    client.send(said("inferred"))
    await inbox.wait(1)
    assert inbox.payloads == [text("inferred")]


async def test_unknown_topic(place: Place) -> None:
    """A publish on a topic of unknown type is counted and costs nothing else."""
    client = await place.client()
    client.send(said("lost", "/nobody"))
    client.send({"op": "unadvertise", "topic": "/never"})
    client.send({"op": "unsubscribe", "topic": "/never"})
    await client.nothing()
    assert place.complaints == {"publish": 1}


async def test_ids_of_an_advertisement(place: Place) -> None:
    """A topic stays until its last registration goes; the same id counts once, an unknown one not at all."""
    client = await place.client()
    for id in ("a", "a", "b", 7, 0):
        client.send({**CHATTER, "id": id})
    for id in ("a", "other", 0, 7):
        client.send({"op": "unadvertise", "topic": "/chatter", "id": id})
    client.send({**CHATTER, "topic": "/marker", "id": "m"})
    client.send({"op": "unadvertise", "topic": "/marker", "id": "m"})
    await client.done()
    await until(lambda: not publishers(place, "/marker"))
    assert len(publishers(place)) == 1
    client.send({"op": "unadvertise", "topic": "/chatter", "id": "b"})
    await until(lambda: not publishers(place))


@pytest.mark.parametrize("more", [{}, {"id": None}], ids=str)
async def test_unadvertise_without_an_id(place: Place, more: dict[str, Any]) -> None:
    """Without an id, or with null, all registrations of the client end at once."""
    client = await place.client()
    for id in ("a", "b", None):
        client.send({**CHATTER, "id": id})
    client.send({"op": "unadvertise", "topic": "/chatter", **more})
    await client.done()
    await until(lambda: not publishers(place))


@pytest.mark.jumping
async def test_linger(bare: Place) -> None:
    """A withdrawn topic lingers, so that one who advertises it again within the time keeps the publisher."""
    await bare.start(unregister_timeout_s=0.3)
    client = await bare.client()
    client.send({**CHATTER, "id": "a"})
    await client.done()
    (before,) = bare.robot.topics()["/chatter"].publishers
    for _ in range(3):
        client.send({"op": "unadvertise", "topic": "/chatter", "id": "a"})
        client.send({**CHATTER, "id": "a"})
        client.send({"op": "unadvertise", "topic": "/chatter", "id": "a"})
        await client.done()
        (now,) = bare.robot.topics()["/chatter"].publishers
        assert now.gid == before.gid
        await asyncio.sleep(0.15)  # half of the time, which begins anew with each withdrawal
    await until(lambda: not publishers(bare))


@pytest.mark.jumping
async def test_publishing_while_it_lingers(bare: Place) -> None:
    """A publish on a lingering topic takes it up again."""
    await bare.start(unregister_timeout_s=0.1)
    inbox = await reader(bare)
    client = await bare.client()
    client.send(CHATTER)
    client.send({"op": "unadvertise", "topic": "/chatter"})
    client.send(said("again"))
    client.send({**CHATTER, "topic": "/marker"})
    client.send({"op": "unadvertise", "topic": "/marker"})
    await inbox.wait(1)
    await until(lambda: not publishers(bare, "/marker"))
    assert len(publishers(bare)) == 1


@pytest.mark.jumping
async def test_linger_after_leaving(bare: Place) -> None:
    """A script that publishes and leaves is still heard by a reader that finds the topic later."""
    await bare.start(unregister_timeout_s=0.5)
    async with Client(bare.port) as client:
        client.send({**CHATTER, "latch": True})
        client.send(said("last words"))
        await client.done()
    await until(lambda: not bare.server.sessions)
    inbox = await reader(bare, qos=LATCHED)
    await inbox.wait(1)
    assert inbox.payloads == [text("last words")]
    await until(lambda: not publishers(bare))
    assert not client_views(bare)


async def test_default_profile(place: Place) -> None:
    """Without qos a topic is reliable, kept for late joiners, 100 deep, for one second, as rosbridge has it."""
    client = await place.client()
    client.send(CHATTER)
    client.send({**CHATTER, "topic": "/latched", "latch": True})
    client.send({**CHATTER, "topic": "/few", "queue_size": 3})
    await client.done()
    assert publishers(place) == [QoS(durability="transient_local", depth=100, lifespan_s=1.0)]
    assert publishers(place, "/latched") == [QoS(durability="transient_local", depth=1)]
    assert publishers(place, "/few") == [QoS(durability="transient_local", depth=3, lifespan_s=1.0)]


async def test_old_messages_do_not_come_back(place: Place, monkeypatch: pytest.MonkeyPatch) -> None:
    """A client that comes late gets what is younger than the lifespan of the topic: no command of yesterday."""
    talker, listener = await place.client(), await place.client()
    talker.send({**CHATTER, "qos": {"durability": "transient_local", "depth": 100, "lifespan": PATIENCE_S}})
    yesterday_ns = time.time_ns() - 86_400 * 10**9
    with monkeypatch.context() as patch:
        patch.setattr(topic_channels, "time", SimpleNamespace(time_ns=lambda: yesterday_ns))
        talker.send(said("old"))
        await talker.done()
    talker.send(said("fresh"))
    await talker.done()
    listener.send(listen())
    assert await listener.json() == heard("fresh")
    inbox = await reader(place, qos=QoS(durability="transient_local", depth=100))
    await inbox.wait(1)
    assert inbox.payloads == [text("fresh")]


async def test_latch(place: Place) -> None:
    """Who comes late gets the last latched message, once, from clients and from the network."""
    talker = await place.client()
    talker.send({**CHATTER, "latch": True})
    for value in ("one", "two"):
        talker.send(said(value))
    await talker.done()
    for _ in range(2):
        listener = await place.client()
        listener.send(listen())
        assert await listener.json() == heard("two")
        await listener.nothing()
    inbox = await reader(place, qos=LATCHED)
    await inbox.wait(1)
    assert inbox.payloads == [text("two")]
    beacon = await place.robot.create_publisher("/map", STRING, LATCHED)
    beacon.publish(sample("the map"))
    talker.send(listen("/map"))
    assert await talker.json() == heard("the map", "/map")
    talker.send({"op": "unsubscribe", "topic": "/map"})
    talker.send(listen("/map", id="again"))
    assert await talker.json() == heard("the map", "/map")
    await talker.nothing()


async def test_qos_object(place: Place) -> None:
    """A qos object rules over latch and queue_size, on both sides; a wrong one is refused with its valid values."""
    client = await place.client()
    profile = {"reliability": "best_effort", "durability": "volatile", "depth": 2, "lifespan": {"secs": 2, "nsecs": 0}}
    client.send({**CHATTER, "latch": True, "queue_size": 9, "qos": profile})
    client.send(listen("/in", qos={"reliability": "Best_Effort", "depth": 4}))
    await client.done()
    assert publishers(place) == [QoS(reliability="best_effort", depth=2, lifespan_s=2.0)]
    (endpoint,) = place.robot.topics()["/in"].subscriptions
    assert (endpoint.qos.reliability, endpoint.qos.depth) == ("best_effort", 4)
    client.send({**CHATTER, "topic": "/x", "qos": {"reliability": "fast"}})
    client.send(listen("/y", qos={"depth": "many"}))
    client.send({**CHATTER, "topic": "/z", "qos": "reliable"})
    client.send({**CHATTER, "topic": "/x"})
    client.send(listen("/y"))
    await client.done()
    assert place.complaints == {"advertise": 1, "subscribe": 1, "operation": 1}
    assert publishers(place, "/x")
    assert place.robot.topics()["/y"].subscriptions


async def test_message_values(place: Place) -> None:
    """Missing fields have their defaults, a header without a stamp gets the time, null stands for NaN."""
    inbox = Inbox()
    await place.robot.create_subscription("/range", "sensor_msgs/msg/Range", QoS(depth=10), inbox)
    client = await place.client()
    before = time.time_ns()
    client.send({"op": "advertise", "topic": "/range", "type": "sensor_msgs/Range"})
    client.send({"op": "publish", "topic": "/range", "msg": {"range": None, "field_of_view": 1}})
    client.send('{"op":"publish","topic":"/range","msg":{"header":{"stamp":{"secs":1,"nsecs":2}},"range":NaN}}')
    client.send({"op": "publish", "topic": "/range"})
    await inbox.wait(3)
    codec = place.registry.codec("sensor_msgs/msg/Range")
    values = [json.loads(codec.json(p)) for p in inbox.payloads]
    stamps = [v["header"]["stamp"]["sec"] * 10**9 + v["header"]["stamp"]["nanosec"] for v in values]
    assert before <= stamps[0] <= time.time_ns()
    assert stamps[1] == 1_000_000_002
    assert [v["range"] for v in values] == [None, None, 0.0]
    assert values[0]["field_of_view"] == 1.0


# ── subscribe, unsubscribe ─────────────────────────────────────────────────────────────────────────────────────────


async def test_plain_frames(place: Place) -> None:
    """A message comes as a text frame of pure ASCII with op, topic and msg in this order, and no id."""
    publisher = await place.robot.create_publisher("/chatter", STRING)
    client = await place.client()
    client.send(listen(id="subscribe:/chatter:1", compression="none", throttle_rate=0, queue_length=0))
    await until(lambda: publisher.subscribers)
    publisher.publish(sample("grüße 🚡"))
    got = await client.receive()
    assert got.text
    assert got.data.isascii()
    assert got.data == rb'{"op":"publish","topic":"/chatter","msg":{"data":"gr\u00fc\u00dfe \ud83d\udea1"}}'


async def test_infers_the_type_of_a_subscription(place: Place) -> None:
    """A subscription without a type takes that of the topic, under its relative name too."""
    publisher = await place.robot.create_publisher("/chatter", STRING)
    client = await place.client()
    client.send({"op": "subscribe", "topic": "chatter"})
    await until(lambda: publisher.subscribers)
    publisher.publish(sample("x"))
    assert await client.json() == heard("x", "chatter")


async def test_ids_of_a_subscription(place: Place) -> None:
    """A client gets a message once however many ids ask for it, until the last of them is gone."""
    publisher = await place.robot.create_publisher("/chatter", STRING)
    client = await place.client()
    for id in ("a", "a", "b", 3):
        client.send(listen(id=id))
    await client.done()
    assert publisher.subscribers == 1
    publisher.publish(sample("1"))
    assert await client.json() == heard("1")
    for id in ("a", "unknown", 3):
        client.send({"op": "unsubscribe", "topic": "/chatter", "id": id})
    await client.done()
    publisher.publish(sample("2"))
    assert await client.json() == heard("2")
    client.send({"op": "unsubscribe", "topic": "/chatter", "id": "b"})
    await client.nothing()
    assert publisher.subscribers == 0
    for id in ("a", "b"):
        client.send(listen(id=id))
    client.send({"op": "unsubscribe", "topic": "/chatter"})
    await client.nothing()
    assert publisher.subscribers == 0


async def test_leaving(place: Place) -> None:
    """A client that leaves reads no longer, and nothing of it is kept."""
    publisher = await place.robot.create_publisher("/chatter", STRING)
    async with Client(place.port) as client:
        client.send(listen())
        await client.done()
        assert publisher.subscribers == 1
        assert len(client_views(place)) == 1
    await until(lambda: publisher.subscribers == 0 and not place.server.sessions)
    await until(lambda: not client_views(place))


async def test_cbor(place: Place) -> None:
    """With cbor a message is a binary frame, byte for byte as rosbridge makes it."""
    publisher = await place.robot.create_publisher("/a_topic", STRING)
    client = await place.client()
    client.send(listen("/a_topic", compression="cbor"))
    await until(lambda: publisher.subscribers)
    publisher.publish(sample("hello"))
    got = await client.receive()
    assert not got.text
    assert got.data.hex() == ("a3626f70677075626c69736865746f706963682f615f746f706963636d7367a164646174616568656c6c6f")


async def test_cbor_raw(place: Place) -> None:
    """With cbor-raw a message is its CDR with the header, and the time at which it passed."""
    publisher = await place.robot.create_publisher("/chatter", STRING)
    client = await place.client()
    client.send(listen(compression="cbor-raw"))
    await until(lambda: publisher.subscribers)
    before = int(time.time())
    publisher.publish(sample("hello"))
    got = await client.receive()
    assert not got.text
    message = got.cbor
    assert list(message) == ["op", "topic", "msg"]
    assert list(message["msg"]) == ["secs", "nsecs", "bytes"]
    assert message["msg"]["bytes"] == text("hello")
    assert before <= message["msg"]["secs"] <= time.time()
    assert 0 <= message["msg"]["nsecs"] < 10**9


async def test_png(place: Place) -> None:
    """With png the text of the operation comes as the pixels of an RGB image, padded with line ends."""
    publisher = await place.robot.create_publisher("/chatter", STRING)
    client = await place.client()
    client.send(listen(compression="png"))
    await until(lambda: publisher.subscribers)
    publisher.publish(sample("ü" * 1000))
    got = await client.json()
    assert list(got) == ["op", "data"]
    width, height, pixels = unpng(got["data"])
    content = pixels.rstrip(b"\n")
    assert json.loads(content) == heard("ü" * 1000)
    assert width == int((len(content) / 3) ** 0.5)
    assert height == -(-len(content) // (3 * width))


@pytest.mark.parametrize(
    ("asked", "binary"),
    [
        (["none", "png"], False),
        (["png", "cbor", "none"], True),
        (["cbor", "cbor-raw", "png"], True),
        (["gzip"], False),
        ([None, "none"], False),
    ],
)
async def test_strongest_compression(place: Place, asked: list[str | None], binary: bool) -> None:
    """Of several ids with different compressions cbor-raw wins over cbor, png and none; an unknown one is none."""
    publisher = await place.robot.create_publisher("/chatter", STRING)
    client = await place.client()
    for id, compression in enumerate(asked):
        client.send(listen(id=id, compression=compression))
    await client.done()
    publisher.publish(sample("x"))
    got = await client.receive()
    assert got.text is not binary
    if binary:
        assert isinstance(got.cbor["msg"].get("bytes"), bytes) is ("cbor-raw" in asked)
    else:
        assert got.json["op"] == ("png" if "png" in asked else "publish")
    await client.nothing()


async def test_every_client_its_compression(place: Place) -> None:
    """Clients with different compressions on one topic do not disturb each other."""
    publisher = await place.robot.create_publisher("/chatter", STRING)
    clients = {c: await place.client() for c in ("none", "png", "cbor", "cbor-raw", "zip", "rawzip")}
    for compression, client in clients.items():
        client.send(listen(compression=compression))
        await client.done()
    for value in ("first", "second"):
        publisher.publish(sample(value))
        assert await clients["none"].json() == heard(value)
        assert json.loads(unpng((await clients["png"].json())["data"])[2]) == heard(value)
        assert (await clients["cbor"].receive()).cbor == heard(value)
        assert (await clients["cbor-raw"].receive()).cbor["msg"]["bytes"] == text(value)
        for compression in ("zip", "rawzip"):
            got = (await clients[compression].receive()).cbor
            assert (got["compression"], got["msg"][:4]) == (compression, b"\x04\x22\x4d\x18")
    for client in clients.values():
        await client.nothing()


async def test_throttle(place: Place) -> None:
    """With throttle_rate alone, what comes sooner after the last message is dropped."""
    publisher = await place.robot.create_publisher("/chatter", STRING)
    client = await place.client()
    client.send(listen(id=1, throttle_rate=60_000))
    client.send(listen("/all"))
    await client.done()
    everything = await place.robot.create_publisher("/all", STRING)
    await until(lambda: everything.subscribers)
    for i in range(10):
        publisher.publish(sample(str(i)))
    everything.publish(sample("end"))
    assert await client.json() == heard("0")
    assert await client.json() == heard("end", "/all")
    client.send(listen(id=2, throttle_rate=0.0))
    await client.done()
    publisher.publish(sample("10"))
    assert await client.json() == heard("10")


@pytest.mark.jumping
async def test_throttled_queue(place: Place) -> None:
    """With a queue too, the newest messages wait for their time: one at once, the others at the rate asked for."""
    publisher = await place.robot.create_publisher("/chatter", STRING)
    client = await place.client()
    client.send(listen(throttle_rate=100, queue_length=3))
    await client.done()
    watch = Stopwatch()
    for i in range(10):
        publisher.publish(sample(str(i)))
    got = []
    for _ in range(4):
        got.append(((await client.json())["msg"]["data"], watch.seconds))
    assert got == [("0", 0), ("7", 0.1), ("8", 0.2), ("9", 0.3)]
    await client.nothing()


@pytest.mark.parametrize("key", ["throttle_rate", "queue_length", "fragment_size"])
@pytest.mark.parametrize("value", [None, 0, 0.0, 2147483647])
async def test_numbers_that_clients_send(place: Place, key: str, value: object) -> None:
    """null, fractions and the largest integer are taken as clients mean them."""
    publisher = await place.robot.create_publisher("/chatter", STRING)
    client = await place.client()
    options: dict[str, Any] = {key: value}
    client.send(listen(**options))
    await client.done()
    publisher.publish(sample("x" * 5000))
    assert await client.json() == heard("x" * 5000)
    assert not place.complaints


async def test_best_effort_publisher(place: Place) -> None:
    """A subscription without qos hears publishers of every kind, also those that come later."""
    client = await place.client()
    client.send(listen())
    await client.done()
    for i, qos in enumerate((SENSOR_DATA, QoS(), LATCHED)):
        publisher = await place.robot.create_publisher("/chatter", STRING, qos)
        await until(lambda p=publisher: p.subscribers)
        publisher.publish(sample(str(i)))
        assert await client.json() == heard(str(i))


# ── fragments and frames ───────────────────────────────────────────────────────────────────────────────────────────


async def test_fragments_out(place: Place) -> None:
    """A client that asks for fragment_size gets longer texts in fragments, with an id of their own for each text."""
    publisher = await place.robot.create_publisher("/chatter", STRING)
    client = await place.client()
    client.send(listen(fragment_size=100, compression="none"))
    await client.done()
    publisher.publish(sample("short"))
    assert await client.json() == heard("short")
    ids = set()
    for letter in "äb":
        publisher.publish(sample(letter * 300))
        first = await client.json()
        parts = [first] + [await client.json() for _ in range(first["total"] - 1)]
        assert [list(p) for p in parts] == [["op", "id", "data", "num", "total"]] * len(parts)
        assert [p["num"] for p in parts] == list(range(first["total"]))
        assert all(len(p["data"]) <= 100 and p["id"] for p in parts)
        assert json.loads("".join(p["data"] for p in parts)) == heard(letter * 300)
        (id,) = {p["id"] for p in parts}
        ids.add(id)
    assert len(ids) == 2
    await client.nothing()


async def test_fragments_of_png(place: Place) -> None:
    """The text of a png operation comes in fragments too; what is binary never does."""
    publisher = await place.robot.create_publisher("/chatter", STRING)
    client = await place.client()
    client.send(listen(fragment_size=100, compression="png"))
    await client.done()
    publisher.publish(sample("".join(map(chr, range(300)))[1:]))
    first = await client.json()
    parts = [first] + [await client.json() for _ in range(first["total"] - 1)]
    whole = json.loads("".join(p["data"] for p in parts))
    assert json.loads(unpng(whole["data"])[2])["op"] == "publish"
    client.send(listen(fragment_size=100, compression="cbor", id="c"))
    await client.done()
    publisher.publish(sample("x" * 500))
    assert (await client.receive()).cbor == heard("x" * 500)


async def test_no_fragments_unless_asked(place: Place) -> None:
    """Nobody else gets fragments: not other clients, not the other topics of the one that asked."""
    publisher = await place.robot.create_publisher("/chatter", STRING)
    other = await place.robot.create_publisher("/other", STRING)
    asking, client = await place.client(), await place.client()
    asking.send(listen(fragment_size=50))
    asking.send(listen("/other"))
    client.send(listen())
    await asking.done()
    await client.done()
    long = "x" * 100_000
    publisher.publish(sample(long))
    other.publish(sample(long))
    assert await client.json() == heard(long)
    seen = set()
    while "publish" not in seen:
        seen.add((await asking.json())["op"])
    assert seen == {"fragment", "publish"}


async def test_fragments_in(place: Place) -> None:
    """An operation in fragments is put together in any order, repeated ones do no harm, ids do not collide."""
    inbox = await reader(place)
    one, two = await place.client(), await place.client()
    for client, value in ((one, "from one"), (two, "from two")):
        client.send(CHATTER)
        whole = json.dumps(said(value))
        parts = [whole[i : i + 10] for i in range(0, len(whole), 10)]
        order = list(range(len(parts)))
        for num in (*reversed(order[1:]), 1):
            client.send({"op": "fragment", "id": 0, "data": parts[num], "num": num, "total": len(parts)})
        client.send({"op": "fragment", "id": 0, "data": parts[0], "num": 0, "total": len(parts)})
    await inbox.wait(2)
    assert sorted(inbox.payloads) == [text("from one"), text("from two")]
    await one.nothing()


async def test_objects_and_frames(place: Place) -> None:
    """Objects may share a frame, be spread over frames, and stand behind what is no JSON."""
    inbox = await reader(place)
    client = await place.client()
    client.send(json.dumps(CHATTER) + json.dumps(said("1")) + " " + json.dumps(said("2")))
    spread = json.dumps(said("3"))
    for i in range(0, len(spread), 7):
        client.send(spread[i : i + 7])
    client.send("so to say: " + json.dumps(said("4")))
    await inbox.wait(4)
    assert inbox.payloads == [text(v) for v in "1234"]


async def test_binary_json(place: Place) -> None:
    """JSON in binary frames, in pieces of 1024 bytes as ROS# sends it, is taken like text."""
    inbox = await reader(place)
    client = await place.client()
    for op in (CHATTER, said("x" * 5000), said("small")):
        client.send_pieces(BINARY, json.dumps(op).encode(), 1024)
    await inbox.wait(2)
    assert inbox.payloads == [text("x" * 5000), text("small")]
    client.send_pieces(BINARY, json.dumps({**listen(), "id": None, "fragment_size": 2147483647}).encode(), 1024)
    client.send_pieces(BINARY, json.dumps(said("echo")).encode(), 1024)
    got = await client.receive()
    assert got.text
    assert got.data.isascii()


async def test_cbor_in(place: Place) -> None:
    """A gateway of the older kind publishes in its binary encodings."""
    import cbor2

    inbox = await reader(place)
    client = await place.client()
    client.send({**CHATTER, "compression": "cbor-raw", "id": "advertise:" + "0" * 32 + ":1"})
    raw = {"op": "publish", "topic": "/chatter", "compression": "cbor-raw"}
    client.send_binary(cbor2.dumps({**raw, "msg": {"secs": 1, "nsecs": 2, "bytes": text("raw")}}))
    client.send_binary(cbor2.dumps({**raw, "msg": text("bare")}))
    client.send_binary(cbor2.dumps({**said("map"), "compression": "cbor"}))
    await inbox.wait(3)
    assert inbox.payloads == [text("raw"), text("bare"), text("map")]
    assert place.session.peer.dialect.name == "rosgw"


# ── other operations ───────────────────────────────────────────────────────────────────────────────────────────────


async def test_calls_are_answered(place: Place) -> None:
    """A call of a service that does not exist is answered with its name as sent and the id as it was."""
    client = await place.client()
    client.send({"op": "call_service", "service": "rosapi/x", "id": {"any": ["value"]}, "args": []})
    client.send({"op": "call_service", "service": "/y#old", "args": {}})
    client.send({"op": "call_service", "service": "/z"})
    assert (await client.receive()).data == (
        b'{"op":"service_response","service":"rosapi/x","values":"Service /rosapi/x does not exist",'
        b'"result":false,"id":{"any":["value"]}}'
    )
    assert await client.json() == {
        "op": "service_response",
        "service": "/y#old",
        "values": "Service /y does not exist",
        "result": False,
        "id": "old",
    }
    assert "id" not in await client.json()


async def test_silence(place: Place) -> None:
    """Nothing but answers and messages is ever sent: no status, no confirmation, no error."""
    client = await place.client()
    for op in (
        CHATTER,
        listen(),
        {"op": "unsubscribe", "topic": "/chatter"},
        {"op": "unadvertise", "topic": "/chatter"},
        {"op": "set_level", "level": "info"},
        {"op": "status", "level": "error", "msg": "x"},
        {"op": "auth", "mac": "x"},
        {"op": "nonsense"},
        {"no": "op"},
        {"op": "subscribe"},
        said("wrong", msg={"data": 5}),
    ):
        client.send(op)
    await client.nothing()


async def test_many_operations_at_once(place: Place) -> None:
    """A client that sends faster than operations are carried out is held back, and everything is done in order."""
    client = await place.client()
    for i in range(300):
        client.send({**CHATTER, "topic": f"/t{i}"})
    for i in range(300):
        client.send({"op": "unadvertise", "topic": f"/t{i}"})
    await client.done()
    assert not place.complaints
    assert place.session.peer.connection.frames_in == 601
    await until(lambda: not [t for t in place.robot.topics() if t.startswith("/t")])


async def test_status(place: Place) -> None:
    """The status of a client tells its dialect, its topics in both directions, and what it did wrong."""
    client = await place.client()
    client.send(CHATTER)
    client.send(listen("/news"))
    client.send(said("one"))
    client.send({"op": "nonsense"})
    await client.done()
    status = place.session.status()
    assert status["dialect"] == "rosbridge"
    assert [(t["name"], t["direction"], t["type"]) for t in status["topics"]] == [
        ("/chatter", "in", STRING),
        ("/news", "out", STRING),
    ]
    assert status["topics"][0]["messages"] == 1
    assert status["complaints"] == {"operation": 1}
    json.dumps(status)


# ── the connection ─────────────────────────────────────────────────────────────────────────────────────────────────


@pytest.mark.parametrize(("path", "answer"), [("/", "101"), ("/?token=x", "101"), ("/other", "404")])
async def test_paths(place: Place, path: str, answer: str) -> None:
    """The server is at /, whatever the query; elsewhere there is nothing."""
    client = await place.client(path=path)
    assert client.status.split()[1] == answer


async def test_subprotocols(place: Place) -> None:
    """Only a client that offers Ropeway's subprotocol gets it; others get none."""
    plain = await place.client(subprotocol="chat, superchat")
    gateway = await place.client(subprotocol=f"chat, {ROPEWAY_SUBPROTOCOL}")
    assert "Sec-WebSocket-Protocol" not in plain.headers
    assert gateway.headers["Sec-WebSocket-Protocol"] == ROPEWAY_SUBPROTOCOL
    assert (await gateway.json())["op"] == "hello"


async def test_going_away(bare: Place) -> None:
    """A server that stops tells its clients so (1001)."""
    await bare.start()
    client = await bare.client()
    await client.done()
    closing = asyncio.ensure_future(client.closed())
    await bare.server.close()
    assert await closing == (1001, "the gateway stops")


async def test_close_is_answered(place: Place) -> None:
    """A client's close is answered with its code, and one without a code with 1000."""
    for code in (b"\x03\xe8", b"\x0f\xa0", b""):
        client = await place.client()
        client.raw(b"\x88" + bytes((0x80 | len(code),)) + bytes(4) + code)
        with pytest.raises(ClosedByServer) as end:
            await client.receive()
        assert end.value.code == (int.from_bytes(code, "big") if code else 1000)
