"""Rosbridge servers of ROS 1 as remotes."""

from __future__ import annotations

import asyncio
import json
from contextlib import AsyncExitStack
from typing import Any

import cbor2
import pytest

from ropeway.graph.calls import Request
from ropeway.listener.connection import Connection
from ropeway.networks.rosbridge.client import RosbridgeGraph
from tests.support.messages import sample
from tests.support.rosbridge import REGISTRY, FakeServer
from tests.support.until import until

pytestmark = pytest.mark.jumping

HEADER = "std_msgs/msg/Header"
RAW = bytes(4) + b"\x64\0\0\0\x05\0\0\0\x01\0\0\0l"
VALUES = {"stamp": {"sec": 100, "nanosec": 5}, "frame_id": "l"}


async def graph(stack: AsyncExitStack, fake: FakeServer, **options: Any) -> RosbridgeGraph:
    made = RosbridgeGraph(fake.url, registry=REGISTRY, **options)
    await made.open()
    stack.push_async_callback(made.close)
    return made


def raw(fake: FakeServer, payload: bytes) -> None:
    message = {"op": "publish", "topic": "/head", "msg": {"secs": 1, "nsecs": 2, "bytes": payload}}
    fake.connections[-1].send_binary(cbor2.dumps(message))


async def test_raw_bytes_show_which_ros_it_is(stack: AsyncExitStack, fake: FakeServer) -> None:
    """Raw bytes that make sense in ROS 1 only are converted, and types are asked for anew in two parts."""
    made = await graph(stack, fake, ask_rosapi=False)
    got: list[Any] = []
    await made.create_subscription("/head", HEADER, None, got.extend)
    await until(lambda: bool(fake.ops("subscribe")))
    assert fake.ops("subscribe")[0]["type"] == HEADER
    raw(fake, RAW)
    await until(lambda: bool(got))
    assert REGISTRY.codec(HEADER).decode(got[0].payload) == VALUES
    await until(lambda: fake.ops("subscribe")[-1]["type"] == "std_msgs/Header")


async def test_rosapi_shows_which_ros_it_is(stack: AsyncExitStack, fake: FakeServer) -> None:
    """Names of two parts in what rosapi tells are those of ROS 1: topics go there in its spelling, as JSON."""
    answers = {"/rosapi/topics": {"topics": ["/chatter"], "types": ["std_msgs/String"]}, "/rosapi/nodes": {}}

    def serve(connection: Connection) -> None:
        def heard(data: bytes) -> None:
            message = json.loads(data)
            fake.heard.append(message)
            if message["op"] == "call_service":
                reply = {"op": "service_response", "service": message["service"], "id": message["id"]}
                fake.say({**reply, "values": answers[message["service"]], "result": True})

        connection.on_text = heard

    fake.on_connection = serve
    made = await graph(stack, fake)
    publisher = await made.create_publisher("/out", HEADER)
    await until(lambda: fake.ops("advertise")[-1]["type"] == "std_msgs/Header")
    one = sample("")
    one.payload, one.type = REGISTRY.codec(HEADER).encode(VALUES), HEADER
    publisher.publish(one)
    await until(lambda: bool(fake.ops("publish")))
    assert fake.ops("publish")[0]["msg"] == {"seq": 0, "stamp": {"secs": 100, "nsecs": 5}, "frame_id": "l"}


@pytest.mark.parametrize("ros1", [True, False])
async def test_told_which_ros_it_is(stack: AsyncExitStack, fake: FakeServer, ros1: bool) -> None:
    """What is configured counts, and bytes that are not of the type never get in."""
    made = await graph(stack, fake, ask_rosapi=False, ros1=ros1)
    got: list[Any] = []
    await made.create_subscription("/head", HEADER, None, got.extend)
    await until(lambda: bool(fake.ops("subscribe")))
    good = RAW if ros1 else REGISTRY.codec(HEADER).encode(VALUES)
    for payload in (b"", b"\0\1\0\0", RAW + b"x" * 9, *(() if ros1 else (RAW,)), good):
        raw(fake, payload)
    await until(lambda: bool(got))
    assert [REGISTRY.codec(HEADER).decode(one.payload) for one in got] == [VALUES]
    assert sum(made.drops.values()) == (3 if ros1 else 4)


async def test_services(stack: AsyncExitStack, fake: FakeServer) -> None:
    """Calls go there in the spelling of ROS 1, and answers come in it."""
    made = await graph(stack, fake, ask_rosapi=False, ros1=True)
    client = await made.create_client("/set", "sensor_msgs/srv/SetCameraInfo")
    request = REGISTRY.codec("sensor_msgs/srv/SetCameraInfo_Request").encode({"camera_info": {"d": [1.5]}})
    call = asyncio.create_task(client.call(Request(request), 5))
    await until(lambda: bool(fake.ops("call_service")))
    sent = fake.ops("call_service")[0]
    assert sent["type"] == "sensor_msgs/SetCameraInfo"
    assert sent["args"]["camera_info"]["D"] == [1.5]
    told = {"values": {"success": True}, "result": True}
    fake.say({"op": "service_response", "id": sent["id"], "service": "/set", **told})
    answer = REGISTRY.codec("sensor_msgs/srv/SetCameraInfo_Response").decode(await call)
    assert answer["success"] is True
