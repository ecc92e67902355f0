"""What a viewer is shown, and what it reads."""

from __future__ import annotations

import asyncio
import json
import time

import pytest

from ropeway.graph.base import SEQ_NONE, Sample
from ropeway.limits import VIEWER_STATUSES, WAITING_OPERATIONS
from ropeway.networks.foxglove.settings import FoxgloveSettings, patterns
from ropeway.qos import LATCHED, QoS
from tests.networks.foxglove.viewer import SDK, WEBSOCKET, Sight, Viewer
from tests.support.messages import STRING, joined, sample, text
from tests.support.until import until

IMAGE = "sensor_msgs/msg/Image"


async def test_a_viewer_is_greeted(sight: Sight) -> None:
    """A viewer first learns what the server is and can do."""
    viewer = await sight.viewer()
    assert viewer.headers["Sec-WebSocket-Protocol"] == SDK
    info = await viewer.op("serverInfo")
    assert info["name"] == "ropeway"
    assert info["supportedEncodings"] == ["cdr", "json"]
    assert "clientPublish" in info["capabilities"]
    assert info["sessionId"]
    older = await sight.viewer(subprotocol=WEBSOCKET)
    assert older.headers["Sec-WebSocket-Protocol"] == WEBSOCKET
    assert (await older.op("serverInfo"))["sessionId"] == info["sessionId"]


async def test_topics_are_channels(sight: Sight) -> None:
    """Topics that are there, that come and that go are channels with their schema, each under an id of its own."""
    await sight.robot.create_publisher("/old", STRING)
    viewer = await sight.viewer()
    old = await viewer.channel("/old")
    publisher = await sight.robot.create_publisher("/camera/image", IMAGE)
    new = await viewer.channel("/camera/image")
    assert new["encoding"] == "cdr"
    assert new["schemaName"] == IMAGE
    assert new["schemaEncoding"] == "ros2msg"
    assert new["schema"] == sight.registry.full_text(IMAGE)
    await publisher.close()
    await viewer.until(lambda: new["id"] not in viewer.channels)
    await sight.robot.create_publisher("/camera/image", IMAGE)
    again = await viewer.channel("/camera/image")
    assert again["id"] not in (old["id"], new["id"])
    assert old["id"] in viewer.channels


async def test_messages_arrive_as_they_are(sight: Sight) -> None:
    """A message arrives under the viewer's own id, with the time of its arrival here, in the bytes that were sent."""
    publisher = await sight.robot.create_publisher("/chatter", STRING)
    viewer = await sight.viewer()
    await viewer.subscribe("/chatter", 77)
    await joined(publisher)
    before = time.time_ns()
    publisher.publish(sample("hello"))
    got = await viewer.message()
    assert (got.subscription, got.payload) == (77, text("hello"))
    assert before - 10**9 <= got.stamp_ns <= time.time_ns()
    (row,) = sight.session.status()["topics"]
    assert (row["name"], row["direction"], row["messages"], row["drops"]) == ("/chatter", "out", 1, {})


async def test_topics_are_read_on_demand(sight: Sight) -> None:
    """A topic is subscribed on the graph while a viewer reads it, and neither before nor after."""
    publisher = await sight.robot.create_publisher("/chatter", STRING)
    one, two = await sight.viewer(), await sight.viewer()
    await one.channel("/chatter")
    await one.passed()
    assert publisher.subscribers == 0
    await one.subscribe("/chatter")
    await two.subscribe("/chatter")
    await joined(publisher, 2)
    one.send({"op": "unsubscribe", "subscriptionIds": [1]})
    await until(lambda: publisher.subscribers == 1)
    two.abort()
    await until(lambda: publisher.subscribers == 0)


async def test_latched_messages_come_to_who_is_late(sight: Sight) -> None:
    """A viewer that comes late gets the latched messages of all publishers of a topic."""
    for value in ("a", "b"):
        node = await sight.participant(f"/{value}")
        (await node.create_publisher("/map", STRING, LATCHED)).publish(sample(value))
    for _ in range(2):
        viewer = await sight.viewer()
        await viewer.subscribe("/map")
        assert {(await viewer.message()).payload for _ in range(2)} == {text("a"), text("b")}


async def test_no_topic_is_shown_that_only_viewers_read(sight: Sight) -> None:
    """A channel goes with its last publisher, although the viewer that reads it still subscribes to the topic."""
    publisher = await sight.robot.create_publisher("/chatter", STRING)
    viewer = await sight.viewer()
    channel = await viewer.subscribe("/chatter")
    await joined(publisher)
    await publisher.close()
    await viewer.until(lambda: channel["id"] not in viewer.channels)
    await until(lambda: "/chatter" not in sight.hub.graph.topics())
    await sight.robot.create_publisher("/chatter", STRING)
    assert (await viewer.subscribe("/chatter", 1))["id"] != channel["id"]
    await viewer.passed()
    assert viewer.told == [told for told in viewer.told if told["op"] != "status"]


async def test_hidden_topics_and_whitelists(dark: Sight) -> None:
    """Topics that no pattern names whole, and hidden ones, are no channels."""
    await dark.start(FoxgloveSettings(topics=patterns(("/a", "/b.*"))))
    for name in ("/a", "/ab", "/bc", "/b/_hidden"):
        await dark.robot.create_publisher(name, STRING)
    viewer = await dark.viewer()
    await viewer.channel("/bc")
    assert {channel["topic"] for channel in viewer.channels.values()} == {"/a", "/bc"}


async def test_types_that_are_not_known(sight: Sight) -> None:
    """A type without a definition has an empty schema and a warning, which is taken back once the type is known."""
    type = "lacking_msgs/msg/Thing"
    publisher = await sight.robot.create_publisher("/thing", type)
    viewer = await sight.viewer()
    channel = await viewer.subscribe("/thing")
    assert channel["schema"] == ""
    warning = await viewer.op("status")
    assert (warning["level"], warning["id"]) == (1, f"type {type}")
    await joined(publisher)
    publisher.publish(Sample(b"\0\1\0\0abcd", type, 0, bytes(16), SEQ_NONE))
    assert (await viewer.message()).payload == b"\0\1\0\0abcd"
    sight.registry.add_text(type, "int32 x\n")
    await viewer.until(lambda: any(each["schema"] == "int32 x\n" for each in viewer.channels.values()))
    assert channel["id"] not in viewer.channels
    assert (await viewer.op("removeStatus"))["statusIds"] == [f"type {type}"]


async def test_a_stalled_viewer_slows_nobody(dark: Sight) -> None:
    """Of a camera only the newest image waits for a viewer that does not read, and another one misses nothing."""
    await dark.start(FoxgloveSettings(send_buffer_bytes=4 << 20))
    camera = await dark.robot.create_publisher("/camera", IMAGE, QoS(depth=5))
    small = await dark.robot.create_publisher("/small", STRING, QoS(depth=5))
    stalled, reading = await dark.viewer(receive_bytes=1024), await dark.viewer()
    for viewer in (stalled, reading):
        await viewer.subscribe("/camera", 1)
        await viewer.subscribe("/small", 2)
    await joined(camera, 2)
    await joined(small, 2)
    first, second = dark.server.sessions
    image = Sample(bytes(1 << 20), IMAGE, 0, bytes(16), SEQ_NONE)
    for number in range(60):
        camera.publish(image)
        small.publish(sample(str(number)))
        assert [len((await reading.message()).payload) > 1000 for _ in range(2)].count(True) == 1
    assert first.sender.outbox.bytes <= 2 << 20
    assert first.connection.unsent_bytes <= 4 << 20
    assert second.sender.outbox.bytes == 0
    rows = {row["name"]: row for row in first.status()["topics"]}
    assert sum(rows["/camera"]["drops"].values()) > 30
    assert {reason for row in second.status()["topics"] for reason in row["drops"]} == set()


async def test_unknown_channels_and_ids(sight: Sight) -> None:
    """Each mistake is answered, counted, and costs the other items of an operation nothing."""
    await sight.robot.create_publisher("/a", STRING)
    await sight.robot.create_publisher("/b", STRING)
    viewer = await sight.viewer()
    a, b = await viewer.channel("/a"), await viewer.channel("/b")
    pairs = [(1, 999), (1, a["id"]), (1, b["id"]), (2, a["id"]), (3, b["id"])]
    viewer.send({"op": "subscribe", "subscriptions": [{"id": id, "channelId": n} for id, n in pairs]})
    viewer.send({"op": "unsubscribe", "subscriptionIds": [9, 3]})
    texts = [await viewer.complaint() for _ in range(4)]
    assert "there is no channel 999" in texts[0]
    assert "subscription 1 is that of /a" in texts[1]
    assert "is subscribed to already" in texts[2]
    assert "there is no subscription 9" in texts[3]
    await viewer.passed()
    assert [row["name"] for row in sight.session.status()["topics"]] == ["/a"]
    assert sight.session.fault_log.counts["subscribe", ""] == 3


@pytest.mark.parametrize(
    ("frame", "said"),
    [
        (b"{", "not JSON"),
        (b"[]", "JSON object"),
        (b"7", "JSON object"),
        (b'{"op":7}', "not known"),
        (b'{"op":"advertise"}', "a list"),
        (b'{"op":"subscribe","subscriptions":[1]}', "another kind"),
        (b'{"op":"subscribe","subscriptions":[{"id":-1,"channelId":1}]}', "32 bits"),
        (b'{"op":"subscribe","subscriptions":[{"id":true,"channelId":1}]}', "32 bits"),
        (b'{"op":"unsubscribe","subscriptionIds":[1e400]}', ""),
        (b'{"op":"unsubscribe","subscriptionIds":"1"}', "a list"),
        (b'{"op":"subscribe","subscriptions":[' + b",".join([b"{}"] * 5000) + b"]}", "at most"),
        (b'{"op":"playbackControlRequest"}', "not known"),
    ],
)
async def test_bad_operations(sight: Sight, frame: bytes, said: str) -> None:
    """What is no operation is answered with a status, and the viewer goes on."""
    viewer = await sight.viewer()
    viewer.send(frame)
    assert said in await viewer.complaint()
    await viewer.passed()
    assert sight.session.fault_log.total == 2


@pytest.mark.parametrize(
    "frame",
    [
        b"",
        b"\x00",
        b"\x01",
        b"\x01\0\0\0",
        b"\x02\0\0\0\0",
        b"\x02" + bytes(8) + b"\xff\xff\xff\xff",
        b"\x02" + bytes(8) + b"\x04\0\0\0cd",
        b"\x02" + bytes(8) + b"\x02\0\0\0\xff\xfe",
        b"\xff" * 50,
        b"\x01" + bytes(4) + b"unknown channel",
    ],
)
async def test_bad_binary_frames(sight: Sight, frame: bytes) -> None:
    """A binary frame that is cut, of an unknown kind or for an unknown channel is answered, and the viewer goes on."""
    viewer = await sight.viewer()
    viewer.send_binary(frame)
    assert await viewer.complaint()
    await viewer.passed()
    assert sight.session.fault_log.total == 2


@pytest.mark.parametrize(
    "operation",
    [
        {"op": "subscribe", "subscriptions": [{"id": 1, "channelId": 1234}]},
        {"op": "unsubscribe", "subscriptionIds": [1]},
        {"op": "advertise", "channels": [{"id": 1, "topic": "/~", "encoding": "cdr", "schemaName": STRING}]},
        {"op": "unadvertise", "channelIds": [1]},
        {"op": "nonsense"},
        b"\x01\x05\0\0\0data",
        b"\x07",
    ],
    ids=lambda operation: operation["op"] if isinstance(operation, dict) else f"opcode {operation[0]}",
)
async def test_ten_thousand_bad_frames(sight: Sight, operation: dict[str, object] | bytes) -> None:
    """Ten thousand bad frames are counted, and answered as far as anybody reads; another viewer is served meanwhile."""
    publisher = await sight.robot.create_publisher("/chatter", STRING)
    good, bad = await sight.viewer(), await sight.viewer()
    await good.subscribe("/chatter")
    await joined(publisher)
    await bad.op("serverInfo")

    async def flood() -> None:
        for number in range(10_000):
            if isinstance(operation, bytes):
                bad.send_binary(operation)
            else:
                bad.send(operation)
            if number % 100 == 0:
                await bad.writer.drain()

    flooding = asyncio.create_task(flood())
    for number in range(20):
        publisher.publish(sample(str(number)))
        assert (await good.message()).payload == text(str(number))
    await flooding
    _, session = sight.server.sessions
    await until(lambda: session.fault_log.total >= 10_000)
    assert session.fault_log.total == 10_000
    assert len(session.turns.waiting) <= 2 * WAITING_OPERATIONS
    await until(lambda: not session.turns.waiting)
    bad.send({"op": "subscribe", "subscriptions": []})
    said = 0
    while said < VIEWER_STATUSES:
        said += (await bad.op("status"))["level"] == 2
    assert len(sight.server.sessions) == 2


async def test_status_is_json(sight: Sight) -> None:
    """The status of a session is JSON, with the keys that those of rosbridge clients have."""
    viewer = await sight.viewer()
    await viewer.op("serverInfo")
    status = json.loads(json.dumps(sight.session.status()))
    assert {"peer", "since", "agent", "bytes_in", "bytes_out", "gateway", "role", "topics", "services"} <= status.keys()
    assert status["dialect"] == SDK


async def test_nothing_is_watched_without_viewers(sight: Sight) -> None:
    """What the graph has is looked at while a viewer is there, and no longer."""
    viewer = await sight.viewer()
    await viewer.op("serverInfo")
    catalogue = sight.server.catalogue
    assert catalogue._watch is not None
    viewer.abort()
    await until(lambda: catalogue._watch is None)
    again: Viewer = await sight.viewer()
    await sight.robot.create_publisher("/late", STRING)
    await again.channel("/late")
