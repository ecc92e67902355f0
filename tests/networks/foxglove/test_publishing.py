"""What viewers publish."""

from __future__ import annotations

import json
import struct
from typing import Any

import pytest

from ropeway.limits import TOPICS_PER_CLIENT
from ropeway.listener.authentication import Door
from ropeway.listener.authorization import VERBS, Role
from ropeway.networks.foxglove.settings import FoxgloveSettings, patterns
from ropeway.qos import QoS
from tests.networks.foxglove.viewer import Sight, Viewer
from tests.support.inbox import Inbox
from tests.support.messages import STRING, text
from tests.support.until import until


def offer(id: int, topic: str, encoding: str = "cdr", type: str = STRING, **more: Any) -> dict[str, Any]:
    """Return the operation that advertises a channel."""
    channel = {"id": id, "topic": topic, "encoding": encoding, "schemaName": type, **more}
    return {"op": "advertise", "channels": [channel]}


def data(id: int, body: bytes) -> bytes:
    """Return the frame of a message."""
    return struct.pack("<BI", 1, id) + body


@pytest.mark.parametrize(
    ("encoding", "body"), [("cdr", text("hello")), ("json", json.dumps({"data": "hello"}).encode())]
)
async def test_publishing(sight: Sight, encoding: str, body: bytes) -> None:
    """A message arrives as CDR, in whichever encoding it came, also if it follows its advertise at once."""
    inbox = Inbox()
    await sight.robot.create_subscription("/cmd", STRING, QoS(), inbox)
    viewer = await sight.viewer()
    viewer.send(offer(3, "/cmd", encoding))
    viewer.send_binary(data(3, body))
    await inbox.wait(1)
    assert inbox.payloads == [text("hello")]
    (row,) = sight.session.status()["topics"]
    assert (row["name"], row["direction"], row["encoding"], row["messages"]) == ("/cmd", "in", encoding, 1)


async def test_a_viewer_hears_itself_and_others(sight: Sight) -> None:
    """What a viewer publishes is a channel for all viewers, itself included, until it leaves."""
    one, two = await sight.viewer(), await sight.viewer()
    one.send(offer(1, "/chat"))
    for viewer in (one, two):
        await viewer.subscribe("/chat")
        await viewer.passed()
    one.send_binary(data(1, text("hi")))
    assert (await one.message()).payload == (await two.message()).payload == text("hi")
    one.abort()
    await two.until(lambda: not [each for each in two.channels.values() if each["topic"] == "/chat"])


async def test_withdrawing(sight: Sight) -> None:
    """A withdrawn channel is gone from the graph, and its number can be used again."""
    viewer = await sight.viewer()
    viewer.send(offer(1, "/a"))
    await until(lambda: "/a" in sight.robot.topics())
    viewer.send({"op": "unadvertise", "channelIds": [1]})
    await until(lambda: "/a" not in sight.robot.topics())
    viewer.send_binary(data(1, text("late")))
    assert "channel 1 was not advertised" in await viewer.complaint()
    viewer.send(offer(1, "/b"))
    await until(lambda: "/b" in sight.robot.topics())


@pytest.mark.parametrize(
    ("operation", "said"),
    [
        (offer(1, "/~x"), "/~x"),
        (offer(1, "/a", type="nonsense"), "nonsense"),
        (offer(1, "/a", type="no_msgs/msg/Thing"), "no_msgs/msg/Thing"),
        (offer(1, "/a", encoding="protobuf"), "protobuf"),
        (offer(1, "/a", encoding="ros1"), "known are cdr and json"),
        (offer(1, "/a" * 200), "characters"),
        (offer(2**32, "/a"), "32 bits"),
        ({"op": "advertise", "channels": [{"id": 1}]}, "topic"),
        ({"op": "unadvertise", "channelIds": [7]}, "was not advertised"),
    ],
)
async def test_bad_offers(sight: Sight, operation: dict[str, Any], said: str) -> None:
    """A channel that cannot be published is answered with why."""
    viewer = await sight.viewer()
    viewer.send(operation)
    assert said in await viewer.complaint()
    await viewer.passed()


@pytest.mark.parametrize(
    ("encoding", "body"),
    [
        ("cdr", b""),
        ("cdr", b"\0\1\0\0\xff\xff\xff\xff"),
        ("cdr", b"\x09" * 20),
        ("json", b"{"),
        ("json", b'{"data":[]}'),
    ],
)
async def test_bad_messages(sight: Sight, encoding: str, body: bytes) -> None:
    """A message that is not of its type is answered and counted, and nobody gets it; the next one arrives."""
    inbox = Inbox()
    await sight.robot.create_subscription("/cmd", STRING, QoS(), inbox)
    viewer = await sight.viewer()
    viewer.send(offer(3, "/cmd", encoding))
    viewer.send_binary(data(3, body))
    assert "/cmd" in await viewer.complaint()
    viewer.send_binary(data(3, text("good") if encoding == "cdr" else b'{"data":"good"}'))
    await inbox.wait(1)
    assert inbox.payloads == [text("good")]


async def test_types_that_viewers_bring(sight: Sight) -> None:
    """A type that is not known is taken from the schema that the viewer gives, and forgotten with the viewer."""
    type = "viewer_msgs/msg/Note"
    viewer = await sight.viewer()
    viewer.send(offer(1, "/note", "json", type, schema="string text\n", schemaEncoding="ros2msg"))
    inbox = Inbox()
    await until(lambda: "/note" in sight.robot.topics())
    await sight.robot.create_subscription("/note", type, QoS(), inbox)
    viewer.send_binary(data(1, b'{"text":"hello"}'))
    await inbox.wait(1)
    assert inbox.payloads == [text("hello")]
    viewer.abort()
    await until(lambda: not sight.registry.has(type))


async def test_rights_and_whitelist(dark: Sight) -> None:
    """A viewer publishes what its role and the whitelist allow, at the rate that its role has."""
    role = Role("driver", {**dict.fromkeys(VERBS, ("*",)), "publish": ("/cmd*",)}, messages_per_s=2)
    await dark.start(FoxgloveSettings(client_topics=patterns(("/cmd", "/free"))), door=Door(default=role))
    viewer = await dark.viewer()
    viewer.send(offer(1, "/free"))
    assert "role driver does not list it under publish" in await viewer.complaint()
    viewer.send(offer(2, "/cmd_other"))
    assert "client_topic_whitelist" in await viewer.complaint()
    for _ in range(3):
        viewer.send(offer(3, "/cmd"))
    assert "messages per second" in await viewer.complaint()


async def test_too_many_channels(sight: Sight) -> None:
    """One channel too many is refused; the others are there."""
    viewer: Viewer = await sight.viewer()
    channels = [offer(number, f"/t{number}")["channels"][0] for number in range(TOPICS_PER_CLIENT + 1)]
    viewer.send({"op": "advertise", "channels": channels})
    assert f"publishes {TOPICS_PER_CLIENT} topics at most" in await viewer.complaint()
    assert len(list(sight.session.publications.status())) == TOPICS_PER_CLIENT
