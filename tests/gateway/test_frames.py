"""Robots that are alike, in one picture: frames under a name of each, transforms under one topic."""

from __future__ import annotations

from typing import Any

import pytest

from ropeway.errors import ConfigError
from ropeway.gateway.config import config
from ropeway.graph.base import SEQ_NONE, Sample
from ropeway.qos import LATCHED, QoS
from ropeway.types import TypeRegistry
from tests.support.inbox import Inbox
from tests.support.until import until
from tests.support.world import World, url

REGISTRY = TypeRegistry()
TF = "tf2_msgs/msg/TFMessage"
POSE = "geometry_msgs/msg/PoseStamped"


def transforms(parent: str, child: str) -> Sample:
    codec = REGISTRY.codec(TF)
    payload = codec.from_json({"transforms": [{"header": {"frame_id": parent}, "child_frame_id": child}]})
    return Sample(payload, TF, 0, bytes(16), SEQ_NONE)


def frames(inbox: Inbox) -> set[tuple[str, str]]:
    messages = [REGISTRY.codec(TF).decode(payload) for payload in inbox.payloads]
    return {(one["header"]["frame_id"], one["child_frame_id"]) for message in messages for one in message["transforms"]}


async def test_five_robots(world: World) -> None:
    """The transforms of all robots meet under one name; who comes late gets the static ones of every robot."""
    cloud = await world.gateway("cloud", [])
    there = await world.robot("cloud")
    publishers = []
    for number in range(5):
        options = {"type": TF, "frame_prefix": f"robot{number}/"}
        items = [{"name": name, **options} for name in ("/tf", "/tf_static")]
        await world.gateway(f"robot{number}", [{"address": url(cloud), "publish": items}])
        robot = await world.robot(f"robot{number}")
        static = await robot.create_publisher("/tf_static", TF, LATCHED)
        static.publish(transforms("base_link", "camera"))
        publishers.append(await robot.create_publisher("/tf", TF, QoS()))
    early, late, moving = Inbox(), Inbox(), Inbox()
    await there.create_subscription("/tf_static", TF, LATCHED, early)
    await early.wait(5)
    await there.create_subscription("/tf_static", TF, LATCHED, late)
    await late.wait(5)
    assert frames(early) == frames(late) == {(f"robot{n}/base_link", f"robot{n}/camera") for n in range(5)}
    await there.create_subscription("/tf", TF, QoS(), moving)
    await until(lambda: all(publisher.subscribers for publisher in publishers))
    for publisher in publishers:
        publisher.publish(transforms("map", "odom"))
    await moving.wait(5)
    assert frames(moving) == {("map", f"robot{n}/odom") for n in range(5)}


async def test_the_way_back(world: World) -> None:
    """What comes in for one robot has the names that the robot knows."""
    cloud = await world.gateway("cloud", [])
    there = await world.robot("cloud")
    item = {"name": "/goal", "remote_name": "/robot1/goal", "type": POSE, "frame_prefix_removed": "robot1/"}
    robot_gateway = await world.gateway("robot", [{"address": url(cloud), "subscribe": [item]}])
    robot = await world.robot("robot")
    inbox = Inbox()
    await robot.create_subscription("/goal", POSE, QoS(), inbox)
    publisher = await there.create_publisher("/robot1/goal", POSE, QoS())
    await until(lambda: publisher.subscribers == 1)
    codec = REGISTRY.codec(POSE)
    for payload in (codec.from_json({"header": {"frame_id": "robot1/odom"}}), b"\0\1\0\0\1"):
        publisher.publish(Sample(payload, POSE, 0, bytes(16), SEQ_NONE))
    await inbox.wait(1)
    assert codec.decode(inbox.payloads[0])["header"]["frame_id"] == "odom"
    (row,) = robot_gateway.status()["routes"]
    await until(lambda: robot_gateway.status()["routes"][0]["drops"])
    (row,) = robot_gateway.status()["routes"]
    assert row["drops"] == {"its frames could not be renamed": 1}


@pytest.mark.parametrize("prefix", ["/robot1/", "a b/", 3, "x" * 200])
def test_a_prefix_that_is_none(prefix: Any) -> None:
    """A prefix that no frame could begin with is refused with its place."""
    item = {"name": "/tf", "type": TF, "frame_prefix": prefix}
    with pytest.raises(ConfigError, match=r"publish\[0\].frame_prefix"):
        config.parse({"gateway": {}, "remotes": [{"address": "ws://a:1", "publish": [item]}]})
