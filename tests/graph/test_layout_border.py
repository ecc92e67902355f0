"""The border of a network with other layouts, on its own and around a rosbridge server of another distribution."""

from __future__ import annotations

import asyncio
from contextlib import AsyncExitStack

import pytest

from ropeway.errors import GraphUnavailable
from ropeway.graph.base import SEQ_NONE, Sample, new_origin
from ropeway.graph.calls import Request
from ropeway.graph.layout_border import Border
from ropeway.networks.factory import make_graph
from ropeway.networks.rosbridge.client import RosbridgeGraph
from ropeway.types import TypeRegistry
from tests.support.rosbridge import FakeServer
from tests.support.until import until

RANGE, LOOK = "sensor_msgs/msg/Range", "my_msgs/srv/Look"
HUMBLE = TypeRegistry("humble", alone=True)


def made() -> TypeRegistry:
    registry = TypeRegistry()
    registry.add_text(LOOK, "sensor_msgs/Range seen\n---\nsensor_msgs/Range found\n")
    return registry


def test_nothing_is_touched_that_never_changed() -> None:
    """Types that are the same everywhere, and everything on a graph without definitions, pass as the same object."""
    payload = b"\0\1\0\0\1\0\0\0\0"
    registry = made()
    assert registry.others is not None
    for border in (Border(None), Border(registry), Border(registry, registry.others.variant("humble"))):
        assert border.incoming("std_msgs/msg/String", payload) is payload
        assert border.outgoing("std_msgs/msg/String", payload) is payload
    assert Border(None).incoming(RANGE, payload) is payload


def test_what_fits_no_layout_passes_as_it_is() -> None:
    """Bytes that are no message in any layout are not this place's business."""
    registry = made()
    assert registry.others is not None
    border = Border(registry, registry.others.variant("humble"))
    assert border.incoming(RANGE, b"no message") == b"no message"
    assert border.outgoing(RANGE, b"no message") == b"no message"


def test_messages_of_a_third_distribution_go_out_in_that_of_the_network() -> None:
    """A recording of Humble that is played to a network of Kilted gets Kilted's layout, and back."""
    registry = made()
    others = registry.others
    assert others is not None
    old = HUMBLE.codec(RANGE).encode({"range": 1.25})
    new = registry.codec(RANGE).encode({"range": 1.25})
    assert Border(registry).outgoing(RANGE, old) == new
    assert Border(registry, others.variant("kilted")).outgoing(RANGE, old) == new
    assert Border(registry, others.variant("humble")).outgoing(RANGE, new) == old
    assert Border(registry, others.variant("humble")).outgoing(RANGE, old) == old


def test_distributions_that_are_none() -> None:
    """A distribution that nobody knows is refused with those that there are."""
    for name in ("noetic", "hubmle"):
        with pytest.raises(GraphUnavailable, match=r"not a ROS 2 distribution; known are foxy, .*lyrical"):
            make_graph(f"dds:0?distro={name}")


async def test_a_rosbridge_server_of_humble(stack: AsyncExitStack, fake: FakeServer) -> None:
    """Topics and services of a remote with a distribution have its fields and no others, and arrive in ours."""
    registry = made()
    assert registry.others is not None
    graph = RosbridgeGraph(
        fake.url, registry=registry, network=registry.others.variant("humble"), ask_rosapi=False, watch=False
    )
    await graph.open()
    stack.push_async_callback(graph.close)
    got: list[Sample] = []
    await graph.create_subscription("/seen", RANGE, None, got.extend)
    publisher = await graph.create_publisher("/range", RANGE)
    payload = registry.codec(RANGE).encode({"range": 1.25, "variance": 2.0})
    publisher.publish(Sample(payload, RANGE, 1, new_origin(), SEQ_NONE))
    await until(lambda: bool(fake.ops("publish")) and bool(fake.ops("subscribe")))
    message = fake.ops("publish")[0]["msg"]
    assert "variance" not in message
    assert message["range"] == 1.25
    fake.say({"op": "publish", "topic": "/seen", "msg": message})
    await until(lambda: bool(got))
    assert registry.codec(RANGE).decode(got[0].payload)["range"] == 1.25

    client = await graph.create_client("/look", LOOK)
    answering = asyncio.create_task(_answer(fake))
    request = registry.codec(f"{LOOK}_Request").encode({"seen": {"range": 2.0, "variance": 1.0}})
    answer = await client.call(Request(request), 5)
    assert registry.codec(f"{LOOK}_Response").decode(answer)["found"]["range"] == 2.0
    await answering
    assert "variance" not in fake.ops("call_service")[0]["args"]["seen"]


async def _answer(fake: FakeServer) -> None:
    """Give a call back what it asks."""
    await until(lambda: bool(fake.ops("call_service")))
    call = fake.ops("call_service")[0]
    values = {"found": call["args"]["seen"]}
    fake.say({"op": "service_response", "service": "/look", "id": call["id"], "values": values, "result": True})
