"""Topics between nodes of ours, beyond what every kind of graph does."""

from __future__ import annotations

import asyncio
import time
from collections.abc import Sequence

import pytest

from ropeway.errors import TypeConflict
from ropeway.graph.base import Sample, new_origin
from ropeway.networks.ros1 import node as ros1_node
from ropeway.networks.ros1.tcpros import encode_header, read_frame, read_header
from ropeway.qos import LATCHED, QoS
from tests.support.until import until

from .conftest import Join
from .messages import STRING, Box, sample, text

HEADER = "std_msgs/msg/Header"
STAMPED = "geometry_msgs/msg/PointStamped"


async def test_keeps_origins(join: Join) -> None:
    """Between nodes of ours a message keeps its origin and its number, also when it is latched."""
    near, far = await join("near"), await join("far")
    publisher = await near.create_publisher("/chatter", STRING, LATCHED)
    origin, seq = new_origin(), time.time_ns() - 5
    publisher.publish(Sample(text("hello"), STRING, time.time_ns(), origin, seq))
    first, second = Box(), Box()
    await far.create_subscription("/chatter", STRING, None, first)
    await until(lambda: first.samples)
    await far.create_subscription("/chatter", STRING, None, second)
    await until(lambda: second.samples)
    for box in (first, second):
        assert [(got.origin, got.seq, got.relayed) for got in box.samples] == [(origin, seq, False)]


async def test_shared_connection(join: Join) -> None:
    """All publishers of one topic are one for the others, and so are all subscriptions."""
    near, far = await join("near"), await join("far")
    boxes = [Box(), Box()]
    for box in boxes:
        await far.create_subscription("/chatter", STRING, QoS(), box)
    publishers = [await near.create_publisher("/chatter", STRING) for _ in range(2)]
    await until(lambda: [publisher.subscribers for publisher in publishers] == [1, 1])
    for number, publisher in enumerate(publishers):
        publisher.publish(sample(text(str(number))))
    await until(lambda: [box.texts for box in boxes] == [["0", "1"]] * 2)
    await publishers[0].close()
    publishers[1].publish(sample(text("2")))
    await until(lambda: boxes[0].texts[-1] == "2")


async def test_two_types(join: Join) -> None:
    """A topic has one type, for those who publish and for those who read."""
    graph = await join()
    await graph.create_publisher("/chatter", STRING)
    with pytest.raises(TypeConflict):
        await graph.create_publisher("/chatter", HEADER)
    await graph.create_subscription("/chatter", STRING, None, lambda _: None)
    with pytest.raises(TypeConflict):
        await graph.create_subscription("/chatter", HEADER, None, lambda _: None)


async def subscriber(port: int, **fields: str) -> tuple[dict[str, str], asyncio.StreamReader, asyncio.StreamWriter]:
    """A subscriber that knows nothing of us, and the header that it is answered."""
    reader, writer = await asyncio.open_connection("127.0.0.1", port)
    writer.write(encode_header({"callerid": "/raw", "topic": "/stamped", "tcp_nodelay": "1", **fields}))
    return await read_header(reader), reader, writer


def port_of(node: ros1_node.Ros1Node | None) -> int:
    assert node is not None
    return node.port


async def test_wire(join: Join) -> None:
    """A subscriber gets the header of ROS 1, and messages whose headers have a seq that counts up."""
    graph = await join()
    publisher = await graph.create_publisher("/stamped", STAMPED, LATCHED)
    fields, reader, writer = await subscriber(port_of(graph._node), md5sum="*", type="*")
    assert fields.pop("message_definition").startswith("std_msgs/Header header\ngeometry_msgs/Point point\n")
    assert fields == {
        "callerid": "/near",
        "latching": "1",
        "md5sum": "c63aecb41bfdfd6b7e1fac37c7cbe7bf",
        "topic": "/stamped",
        "type": "geometry_msgs/PointStamped",
    }
    codec = graph.registry.codec(STAMPED)
    for letter in "ab":
        publisher.publish(sample(codec.encode({"header": {"frame_id": letter}}), STAMPED))
    first, second = [await read_frame(reader) for _ in range(2)]
    assert int.from_bytes(second[:4], "little") == int.from_bytes(first[:4], "little") + 1
    assert [first[4:], second[4:]] == [bytes(8) + b"\1\0\0\0" + letter + bytes(24) for letter in (b"a", b"b")]
    writer.close()


async def test_error_field(join: Join) -> None:
    """A subscriber with another sum is answered with an ``error`` and hung up on."""
    graph = await join()
    await graph.create_publisher("/stamped", STAMPED)
    fields, reader, writer = await subscriber(port_of(graph._node), md5sum="0" * 32, type="geometry_msgs/PointStamped")
    assert list(fields) == ["error"]
    assert "c63aecb41bfdfd6b7e1fac37c7cbe7bf" in fields["error"]
    assert await reader.read() == b""
    writer.close()


async def test_other_type(join: Join, caplog: pytest.LogCaptureFixture) -> None:
    """A publisher of another type is not read; the log says so once, with both sums."""
    near, far = await join("near"), await join("far")
    box = Box()
    await far.create_publisher("/chatter", HEADER, LATCHED)
    await near.create_subscription("/chatter", STRING, None, box)
    await until(lambda: "2176decaecbce78abc3b96ef049fabed" in caplog.text)
    assert "992ce8a1687cec8c8bd883ec73ca41d1" in caplog.text
    assert not box.samples


async def test_batches(join: Join) -> None:
    """What arrives together is given together."""
    near, far = await join("near"), await join("far")
    sizes: list[int] = []

    def count(batch: Sequence[Sample]) -> None:
        sizes.append(len(batch))

    await far.create_subscription("/chatter", STRING, QoS(), count)
    publisher = await near.create_publisher("/chatter", STRING, QoS(history="keep_all"))
    await until(lambda: publisher.subscribers == 1)
    for _ in range(1000):
        publisher.publish(sample(text("x")))
    await until(lambda: sum(sizes) == 1000)
    assert len(sizes) < 500


async def test_nobody_listens(join: Join) -> None:
    """What nobody reads is not even converted."""
    graph = await join()
    publisher = await graph.create_publisher("/chatter", STRING)
    publisher.publish(sample(b"nonsense"))
    assert not graph.drops
    latched = await graph.create_publisher("/latched", STRING, LATCHED)
    latched.publish(sample(b"nonsense"))
    assert sum(graph.drops.values()) == 1


async def test_no_trace_of_closed_parts(join: Join) -> None:
    """What is closed is withdrawn from the master, and all can be made again."""
    near, far = await join("near"), await join("far")
    for _ in range(3):
        publisher = await near.create_publisher("/chatter", STRING)
        subscription = await near.create_subscription("/chatter", STRING, None, lambda _: None)
        await until(lambda: "/chatter" in far.topics())
        await publisher.close()
        await subscription.close()
        await until(lambda: "/chatter" not in far.topics())
