"""What clients do wrong: counted, logged once per kind and minute, answered as rosbridge does, in nobody's way."""

from __future__ import annotations

import base64
import json
import logging
import struct
from typing import Any

import cbor2
import lz4.frame
import pytest
import zstandard

from ropeway.listener.connection import Limits
from ropeway.networks.rosbridge.protocol.dialect import ROPEWAY_SUBPROTOCOL
from ropeway.qos import QoS
from tests.networks.rosbridge.server.test_session import CHATTER, heard, listen, publishers, said
from tests.support.inbox import Inbox
from tests.support.messages import STRING, sample, text
from tests.support.place import Place
from tests.support.until import until
from tests.support.websocket import BINARY, TEXT, Client, frame

pytestmark = pytest.mark.jumping

IMAGE = {"op": "advertise", "topic": "/image", "type": "sensor_msgs/Image"}
PUBLISH = {"op": "publish", "topic": "/chatter", "msg": {"data": "x"}}
MSG = {**PUBLISH, "compression": "zip"}


def cbor(op: object) -> bytes:
    return frame(BINARY, cbor2.dumps(op))


def json_frame(op: object) -> bytes:
    return frame(TEXT, json.dumps(op).encode())


BAD: dict[str, tuple[bytes, dict[str, int]]] = {
    # frames
    "not json": (frame(TEXT, b"hello, are you a robot?"), {"frame": 1}),
    "cut json": (frame(TEXT, b'{"op":"publish","topic":') + frame(TEXT, b"]]]]"), {"frame": 1}),
    "json array": (frame(TEXT, b'[{"op":"publish"}]'), {"frame": 1}),
    "json number": (frame(TEXT, b"5"), {"frame": 1}),
    "json null": (frame(TEXT, b"null"), {"frame": 1}),
    "empty text": (frame(TEXT, b""), {"frame": 1}),
    "empty binary": (frame(BINARY, b""), {"frame": 1}),
    "invalid utf-8": (frame(TEXT, b'{"op":"publish","topic":"\xff\xfe"}'), {"frame": 1}),
    "invalid utf-8 in binary": (frame(BINARY, b'{"op":"\xc3\x28"}'), {"frame": 1}),
    "half a surrogate": (frame(TEXT, rb'{"op":"publish","topic":"\ud800"}'), {"frame": 1}),
    "deep json": (frame(TEXT, b'{"op":"publish","msg":' + b"[" * 100_000 + b"]" * 100_000 + b"}"), {"frame": 1}),
    "deep objects": (frame(TEXT, b'{"a":' * 50_000 + b"1" + b"}" * 50_000), {"frame": 1}),
    "not cbor": (frame(BINARY, b"\xa3\x62op\xff\xff"), {"frame": 1}),
    "cut cbor": (frame(BINARY, cbor2.dumps(PUBLISH)[:-3]), {"frame": 1}),
    "deep cbor": (frame(BINARY, b"\xa1\x61a" + b"\x81" * 100_000 + b"\x00"), {"frame": 1}),
    "endless cbor": (frame(BINARY, b"\xbb\xff\xff\xff\xff\xff\xff\xff\xff"), {"frame": 1}),
    "cbor array": (frame(BINARY, b"\x83\x01\x02\x03"), {"frame": 1}),
    "cbor date": (frame(BINARY, b"\xa1\x62op\xc0\x61x"), {"frame": 1}),
    # operations
    "no op": (json_frame({"topic": "/x"}), {"operation": 1}),
    "unknown op": (json_frame({"op": "fly"}), {"operation": 1}),
    "op is a list": (json_frame({"op": ["publish"]}), {"operation": 1}),
    "op is null": (json_frame({"op": None}), {"operation": 1}),
    "no topic": (json_frame({"op": "subscribe"}), {"operation": 1}),
    "topic is a number": (json_frame({"op": "advertise", "topic": 5, "type": "std_msgs/String"}), {"operation": 1}),
    "no type": (json_frame({"op": "advertise", "topic": "/x"}), {"operation": 1}),
    "msg is a list": (json_frame({**PUBLISH, "msg": [1]}), {"operation": 1}),
    "msg is null": (json_frame({**PUBLISH, "msg": None}), {"operation": 1}),
    "throttle is a text": (json_frame(listen(throttle_rate="fast")), {"operation": 1}),
    "cbor id": (cbor({**PUBLISH, "id": b"\x00\xff"}), {"operation": 1}),
    "not for a server": (json_frame({"op": "png", "data": "x"}), {"operation": 1}),
    "bad fragment": (json_frame({"op": "fragment", "id": 1, "num": 3, "total": 2, "data": ""}), {"operation": 1}),
    "fragments of no json": (
        json_frame({"op": "fragment", "id": 1, "num": 0, "total": 1, "data": "]"}),
        {"fragment": 1},
    ),
    # names and types
    "bad name": (json_frame({**CHATTER, "topic": "/1/ x"}), {"advertise": 1}),
    "long name": (json_frame({**CHATTER, "topic": "/ " * 100_000}), {"operation": 1}),
    "empty name": (json_frame(listen("")), {"subscribe": 1}),
    "bad type": (json_frame({**CHATTER, "topic": "/x", "type": "String"}), {"advertise": 1}),
    "unknown type": (json_frame({**CHATTER, "topic": "/x", "type": "my_msgs/Own"}), {"advertise": 1}),
    "unknown type read": (json_frame(listen("/x", type="my_msgs/Own")), {"subscribe": 1}),
    "type conflict": (json_frame({**CHATTER, "type": "std_msgs/Int32"}), {"advertise": 1}),
    "type conflict of a reader": (json_frame(listen(type="std_msgs/Int32")), {"subscribe": 1}),
    "conflict with the network": (
        json_frame({**CHATTER, "topic": "/robot", "type": "std_msgs/Int32"}),
        {"advertise": 1},
    ),
    "not advertised": (json_frame(said("x", "/never")), {"publish": 1}),
    # profiles
    "qos policy": (json_frame({**CHATTER, "topic": "/x", "qos": {"speed": 1, "depth": -1}}), {"advertise": 1}),
    "qos depth": (json_frame({**CHATTER, "topic": "/x", "qos": {"depth": 2**40}}), {"advertise": 1}),
    "qos duration": (json_frame(listen("/x", qos={"lifespan": {"secs": [], "nsecs": {}}})), {"subscribe": 1}),
    "qos keys": (cbor(listen("/x", qos={1: 2, "depth": "a"})), {"subscribe": 1}),
    # messages
    "unknown field": (json_frame({**PUBLISH, "msg": {"datum": "x"}}), {"publish": 1}),
    "wrong field": (json_frame({**PUBLISH, "msg": {"data": 5}}), {"publish": 1}),
    "wrong map": (cbor({**PUBLISH, "msg": {1: 2, b"data": None}}), {"publish": 1}),
    "wrong base64": (json_frame({**PUBLISH, "topic": "/image", "msg": {"data": "abcde"}}), {"publish": 1}),
    "out of range": (json_frame({**PUBLISH, "topic": "/image", "msg": {"height": -1}}), {"publish": 1}),
    "huge number": (json_frame({**PUBLISH, "topic": "/image", "msg": {"height": 10**400}}), {"publish": 1}),
    "wrong array": (cbor({**PUBLISH, "topic": "/image", "msg": {"data": cbor2.CBORTag(85, b"123")}}), {"publish": 1}),
    "wrong tag": (cbor({**PUBLISH, "topic": "/image", "msg": {"height": cbor2.CBORTag(9999, 1)}}), {"publish": 1}),
    "not lz4": (cbor({**MSG, "msg": b"\x04\x22\x4d\x18garbage"}), {"publish": 1}),
    "cut lz4": (cbor({**MSG, "msg": lz4.frame.compress(b"x" * 500)[:-9]}), {"publish": 1}),
    "lz4 of no cbor": (cbor({**MSG, "msg": lz4.frame.compress(b"\xff\xff")}), {"publish": 1}),
    "lz4 bomb": (cbor({**MSG, "msg": lz4.frame.compress(bytes(3_000_000))}), {"publish": 1}),
    "lz4 of no cdr": (
        cbor({**MSG, "compression": "rawzip", "msg": lz4.frame.compress(b"no cdr")}),
        {"publish": 1},
    ),
    "not zstd": (cbor({**MSG, "compression": "zstd", "msg": b"\x28\xb5\x2f\xfdxx"}), {"publish": 1}),
    "zstd bomb": (
        cbor({**MSG, "compression": "zstd", "msg": b"\0" + zstandard.compress(bytes(3_000_000))}),
        {"publish": 1},
    ),
    "not cdr": (cbor({**MSG, "compression": "cbor-raw", "msg": b"\x00\x03\x00\x00xxxx"}), {"publish": 1}),
    "short cdr": (cbor({**MSG, "compression": "cbor-raw", "msg": b"\x00"}), {"publish": 1}),
}


def _name(value: object) -> str:
    return repr(value)[:12]


@pytest.mark.parametrize("name", BAD)
async def test_bad_input(bare: Place, name: str, caplog: pytest.LogCaptureFixture) -> None:
    """It is counted and told in one line of the log, nothing is answered, the connection and all topics live on."""
    data, wrong = BAD[name]
    await bare.start(limits=Limits(max_message_bytes=2 << 20))
    client, other = await bare.client(), await bare.client()
    robot = await bare.robot.create_publisher("/robot", STRING)
    inbox = Inbox()
    await bare.robot.create_subscription("/chatter", STRING, QoS(depth=10), inbox)
    for one in (client, other):
        one.send(listen("/robot"))
        one.send(CHATTER)
        one.send(IMAGE)
        await one.done()
    caplog.set_level(logging.WARNING)
    client.raw(data)
    client.raw(data)
    for i, one in enumerate((client, other)):
        one.send(said(f"after {i}"))
    await inbox.wait(2)
    assert {k: n // 2 for k, n in bare.complaints.items()} == wrong
    assert len(caplog.messages) == 1, caplog.messages
    (line,) = caplog.messages
    assert line.startswith("127.0.0.1:")
    assert len(line) < 1000
    robot.publish(sample("still here"))
    assert await client.json() == await other.json() == heard("still here", "/robot")
    await client.nothing()
    assert len(bare.server.sessions) == 2
    assert not [t for t in bare.robot.topics() if t in ("/x", "/never", "/1/ x")]


async def test_malformed_cdr(place: Place) -> None:
    """CDR that is not of its type is refused from whoever publishes it raw, and nobody gets it."""
    reader, raw_reader, writer = await place.client(), await place.client(), await place.client()
    reader.send(listen())
    raw_reader.send(listen(compression="cbor-raw"))
    for one in (reader, raw_reader):
        await one.done()
    writer.send({**CHATTER, "compression": "cbor-raw"})
    for payload in (b"\0\1\0\0\xff\xff\xff\x7f", b"\0\1\0\0", b"\0\1\0\0\x02\0\0\0x", text("fine")):
        writer.send_binary(cbor2.dumps({**PUBLISH, "compression": "cbor-raw", "msg": payload}))
    assert await reader.json() == heard("fine")
    last = await raw_reader.receive()
    assert last.cbor["msg"]["bytes"] == text("fine")
    assert place.complaints == {"publish": 3}


async def test_limits_of_one_client(place: Place) -> None:
    """A client cannot fill the memory with topics, with ids, or with what it begins and never ends."""
    client = await place.client()
    for i in range(1100):
        client.send(listen(id=i))
        client.send({**CHATTER, "id": i})
    await client.done()
    session = place.session
    assert len(session.outputs["/chatter"].requests) == len(session.inputs["/chatter"].ids) == 1024
    assert place.complaints == {"subscribe": 76, "advertise": 76}
    client.send({"op": "unadvertise", "topic": "/chatter"})
    client.send({**CHATTER, "id": 5000})
    await client.done()
    assert len(session.inputs["/chatter"].ids) == 1


async def test_too_many_topics(place: Place, monkeypatch: pytest.MonkeyPatch) -> None:
    """A client may have so many topics and no more; what it has goes on."""
    from ropeway.networks.rosbridge.server import topic_ops

    monkeypatch.setattr(topic_ops, "TOPICS_PER_CLIENT", 10)
    client = await place.client()
    for i in range(8):
        client.send(listen(f"/t{i}"))
        client.send({**CHATTER, "topic": f"/t{i}"})
    await client.done()
    assert len(place.session.outputs) + len(place.session.inputs) == 10
    assert place.complaints == {"subscribe": 3, "advertise": 3}
    client.send(said("x", "/t0"))
    assert await client.json() == heard("x", "/t0")


@pytest.mark.parametrize("number", [1e300, -1e300, 10**400, -(10**400), 2**64, -5, 0.1, 1e-320], ids=_name)
async def test_odd_numbers(place: Place, number: float) -> None:
    """No number is too odd: what cannot be meant is refused or taken for the nearest that can."""
    client = await place.client()
    text_of = json.dumps(number)
    for i, key in enumerate(("throttle_rate", "queue_length", "fragment_size")):
        client.send(f'{{"op":"subscribe","topic":"/t{i}","type":"std_msgs/String","{key}":{text_of},"id":{text_of}}}')
    client.send(f'{{"op":"advertise","topic":"/q","type":"std_msgs/String","queue_size":{text_of}}}')
    for key in ("depth", "lifespan", "deadline"):
        qos = f'{{"{key}":{text_of},"durability":"transient_local"}}'
        client.send(f'{{"op":"advertise","topic":"/{key}","type":"std_msgs/String","qos":{qos}}}')
        client.send(f'{{"op":"publish","topic":"/{key}","type":"std_msgs/String","msg":{{"data":"x"}}}}')
    client.send(CHATTER)
    await client.done()
    assert publishers(place)
    publisher = await place.robot.create_publisher("/t0", STRING)
    for i in range(3):
        publisher.publish(sample(str(i)))
    assert (await client.json())["msg"]["data"] == "0"


@pytest.mark.parametrize("number", [float("nan"), float("inf"), 1e300, 10**400, -1, 0, True, "1", [], 65536], ids=_name)
async def test_odd_numbers_of_a_gateway(place: Place, number: object) -> None:
    """A gateway that gives a topic odd numbers is refused it, or gets the default, and the others live on."""
    client = await place.client(subprotocol=ROPEWAY_SUBPROTOCOL)
    assert (await client.json())["op"] == "hello"
    odd = json.dumps(number)
    sub = '{"op":"subscribe","topic":"/t","type":"std_msgs/msg/String","id":"s","ropeway":{"channel":'
    for key in ("rate_hz", "depth", "priority", "lifespan_s", "weight"):
        client.send(f'{sub}3,"{key}":{odd}}}}}')
    client.send(f"{sub}{odd}}}}}")
    client.send(f"{sub.replace('subscribe', 'advertise')}{odd}}}}}")
    client.send(f"{sub}4}}}}")
    client.send({"op": "demand", "channel": number, "count": number})
    await client.done()
    publisher = await place.robot.create_publisher("/t", STRING)
    await until(lambda: publisher.subscribers)
    publisher.publish(sample("x"))
    while True:
        got = await client.receive()
        if not got.text:
            break
    assert b'{"data":"x"}' in got.data
    assert set(place.session.topics.output_channels) == {3, 4}


async def test_channels_of_a_gateway(place: Place) -> None:
    """A gateway that uses a channel number twice has one topic under it, and leaves nothing behind."""
    client = await place.client(subprotocol=ROPEWAY_SUBPROTOCOL)
    old = await place.robot.create_publisher("/old", STRING)
    new = await place.robot.create_publisher("/new", STRING)
    for topic in ("/old", "/new", "/new"):
        client.send({**listen(topic, id=topic), "ropeway": {"channel": 7}})
        client.send({**CHATTER, "topic": f"{topic}_in", "id": topic, "ropeway": {"channel": 7}})
    await until(lambda: new.subscribers == 1 and old.subscribers == 0)
    await until(lambda: publishers(place, "/old_in"))
    assert not publishers(place, "/new_in")
    assert place.complaints == {"advertise": 2}
    told = []
    while "refused" not in told:
        told.append((await client.json())["op"])


async def test_definitions_of_a_gateway(place: Place) -> None:
    """A definition that cannot be read, or is too long, is refused with its topic."""
    client = await place.client(subprotocol=ROPEWAY_SUBPROTOCOL)
    for i, text_of in enumerate(("not a definition at all !!", "int32 x\n" * 200_000, "my_msgs/Missing x")):
        note = {"channel": i + 1, "definition": text_of}
        client.send({"op": "advertise", "topic": f"/x{i}", "type": f"my_msgs/msg/Own{i}", "ropeway": note})
    await until(lambda: place.complaints.get("advertise", 0) >= 2)
    assert not place.session.registry.has("my_msgs/msg/Own0")
    assert not place.session.registry.has("my_msgs/msg/Own1")


async def test_one_bad_client_among_many(place: Place) -> None:
    """A client that sends rubbish as fast as it can costs the others neither messages nor their order."""
    publisher = await place.robot.create_publisher("/robot", STRING, QoS(depth=1000))
    good, bad = await place.client(), await place.client()
    good.send(listen("/robot"))
    await good.done()
    rubbish = b"".join(data for data, _ in BAD.values() if len(data) < 10_000)
    for i in range(100):
        bad.raw(rubbish)
        publisher.publish(sample(str(i)))
        assert await good.json() == heard(str(i), "/robot")
    await bad.writer.drain()
    assert len(place.server.sessions) == 2


async def test_base64_of_the_right_kind(place: Place) -> None:
    """What looks odd and is right is taken."""
    inbox = Inbox()
    await place.robot.create_subscription("/image", "sensor_msgs/msg/Image", QoS(depth=10), inbox)
    client = await place.client()
    client.send(IMAGE)
    pixels = struct.pack("<3B", 1, 2, 255)
    msgs: list[Any] = [{"data": base64.b64encode(pixels).decode()}, {"data": [1, 2, 255]}]
    for msg in msgs:
        client.send({"op": "publish", "topic": "/image", "msg": msg})
    client.send_binary(cbor2.dumps({"op": "publish", "topic": "/image", "msg": {"data": pixels}}))
    client.send_binary(cbor2.dumps({"op": "publish", "topic": "/image", "msg": {"data": cbor2.CBORTag(64, pixels)}}))
    await inbox.wait(4)
    assert all(p.endswith(b"\x03\0\0\0" + pixels) for p in inbox.payloads)
    assert not place.complaints


async def test_too_big(bare: Place) -> None:
    """A message above the limit closes its connection with 1009 and the limit; other clients do not notice."""
    await bare.start(limits=Limits(max_message_bytes=100_000))
    other = await bare.client()
    for opcode, pieces in ((TEXT, False), (BINARY, False), (TEXT, True)):
        async with Client(bare.port) as client:
            big = json.dumps(said("x" * 200_000)).encode()
            if pieces:
                client.send_pieces(opcode, big, 1024)
            else:
                client.raw(frame(opcode, big))
            code, reason = await client.closed()
            assert code == 1009
            assert "100000" in reason
    await until(lambda: len(bare.server.sessions) == 1)
    await other.done()


HALF = r"\ud83d"
NESTED = "[" * 200 + "]" * 200
UNREADABLE = {
    "an argument": ("s", f'"service":"/nowhere","args":{{"data":"{HALF}"}}'),
    "the name of an argument": ("s", f'"service":"/nowhere","args":{{"{HALF}":1}}'),
    "the service": ("s", f'"service":"/{HALF}"'),
    "the type": ("s", f'"service":"/nowhere","type":"{HALF}"'),
    "the id": (HALF, '"service":"/nowhere"'),
    "another key": ("s", f'"service":"/nowhere","{HALF}":0'),
    "depth": ("s", f'"service":"/nowhere","args":{{"a":{NESTED}}}'),
}


@pytest.mark.parametrize("where", UNREADABLE)
@pytest.mark.parametrize("op", ["call_service", "send_action_goal"])
async def test_requests_that_cannot_be_read_are_answered(place: Place, op: str, where: str) -> None:
    """A request with half a surrogate pair anywhere, or nested too deeply, fails at once under its own id."""
    id, rest = UNREADABLE[where]
    if op == "send_action_goal":
        rest = rest.replace('"service"', '"action"')
    client = await place.client()
    client.send(f'{{"op":"{op}","id":"{id}",{rest}}}')
    got = await client.receive()
    assert got.text
    answer = json.loads(got.data)
    assert answer["result"] is False
    assert answer["id"] == json.loads(f'"{id}"')
    assert "half a surrogate pair" in str(answer["values"]) or "nested" in str(answer["values"])


async def test_cbor_requests_that_cannot_be_read_are_answered(place: Place) -> None:
    """A request in CBOR with a date, or a text that is none, in it fails at once under its own id."""
    client = await place.client()
    call = {"op": "call_service", "id": "s", "service": "/nowhere"}
    for bad in (cbor2.CBORTag(0, "x"), cbor2.CBORTag(2, b"x")):
        client.raw(frame(BINARY, cbor2.dumps({**call, "args": {"a": bad}})))
        answer = await client.receive()
        assert json.loads(answer.data)["id"] == "s"
    client.raw(frame(BINARY, cbor2.dumps({**call, "args": {"a": "xx"}}).replace(b"\x62xx", b"\x62\xc3\x28")))
    assert json.loads((await client.receive()).data)["result"] is False


async def test_other_operations_with_an_id_are_told(place: Place) -> None:
    """A client that wants to know is told of any operation with an id that cannot be read."""
    client = await place.client(path="/?status=1")
    for op in ("subscribe", "advertise", "unsubscribe", "publish"):
        client.send(f'{{"op":"{op}","id":"x1","topic":"/{HALF}"}}')
        answer = json.loads((await client.receive()).data)
        assert (answer["op"], answer["id"]) == ("status", "x1")


async def test_one_bad_object_costs_no_other_of_its_frame(place: Place) -> None:
    """Of several objects in one frame, those that can be read are carried out and the others answered."""
    client = await place.client()
    bad = f'{{"op":"call_service","id":"bad","service":"/{HALF}"}}'
    client.send(bad + '{"op":"call_service","id":"good","service":"/nowhere"}' + bad)
    ids = [json.loads((await client.receive()).data)["id"] for _ in range(3)]
    assert sorted(ids) == ["bad", "bad", "good"]
