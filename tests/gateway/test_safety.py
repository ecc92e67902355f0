"""A robot's gateway guards topics of commands, whoever publishes them and whatever the links do."""

from __future__ import annotations

import logging
from typing import Any

import pytest

from ropeway.errors import ConfigError
from ropeway.gateway.config.config import parse
from ropeway.graph.base import Sample
from ropeway.qos import QoS
from ropeway.types import TypeRegistry
from tests.support.inbox import Inbox
from tests.support.until import until
from tests.support.world import World, url

TWIST = "geometry_msgs/msg/Twist"
CODEC = TypeRegistry().codec(TWIST)
GUARD = {"topic": "/cmd_vel", "type": TWIST, "lease_s": 0.2, "max": {"linear.x": 0.5}}
ROUTE = {"name": "/cmd_vel", "type": TWIST}


def command(number: int, x: float = 1.0) -> Sample:
    """Make a command."""
    return Sample(CODEC.encode({"linear": {"x": x}}), TWIST, 0, bytes(16), number)


def speeds(inbox: Inbox) -> list[float]:
    """Return what the robot was told."""
    return [CODEC.decode(payload)["linear"]["x"] for payload in inbox.payloads]


@pytest.mark.parametrize("operation", ["publish", "subscribe"])
async def test_the_robot_stops(world: World, caplog: pytest.LogCaptureFixture, operation: str) -> None:
    """When commands stop coming, the robot's gateway publishes zero by itself, whichever side dials."""
    caplog.set_level(logging.WARNING)
    if operation == "publish":
        robot = await world.gateway("robot", [], safety=[GUARD])
        await world.gateway("cloud", [{"address": url(robot), "publish": [ROUTE]}])
    else:
        cloud = await world.gateway("cloud", [])
        safety = {key: value for key, value in GUARD.items() if key not in ("topic", "type")}
        robot = await world.gateway("robot", [{"address": url(cloud), "subscribe": [{**ROUTE, "safety": safety}]}])
    base, planner = await world.robot("robot"), await world.robot("cloud")
    inbox = Inbox()
    await base.create_subscription("/cmd_vel", TWIST, QoS(), inbox)
    publisher = await planner.create_publisher("/cmd_vel", TWIST)
    await until(lambda: bool(publisher.subscribers))
    publisher.publish(command(1))
    publisher.publish(command(2, 0.25))
    await inbox.wait(5)
    assert speeds(inbox) == [0.5, 0.25, 0.0, 0.0, 0.0]
    assert "/cmd_vel: no command came within the lease" in caplog.text
    (status,) = robot.status()["safety"]
    assert (status["expiries"], status["clamped"], status["driver"]) == (1, 1, "")
    publisher.publish(command(3, 0.1))
    await inbox.wait(6)
    assert speeds(inbox)[5] == 0.1


async def test_one_driver(world: World) -> None:
    """Of two drivers that dial in, the first has the robot for as long as it drives."""
    robot = await world.gateway("robot", [], safety=[{**GUARD, "lease_s": 60.0, "max": {}, "drivers": "first"}])
    base = await world.robot("robot")
    inbox = Inbox()
    await base.create_subscription("/cmd_vel", TWIST, QoS(), inbox)
    publishers = []
    for name in ("one", "two"):
        await world.gateway(name, [{"address": url(robot), "publish": [ROUTE]}])
        planner = await world.robot(name)
        publishers.append(await planner.create_publisher("/cmd_vel", TWIST))
    await until(lambda: all(publisher.subscribers for publisher in publishers))
    publishers[0].publish(command(1, 0.1))
    await inbox.wait(1)
    publishers[1].publish(command(2, 0.2))
    await until(lambda: bool(robot.status()["safety"][0]["refused"]))
    assert speeds(inbox) == [0.1]
    assert robot.status()["safety"][0]["refused"] == {"another driver holds the lease": 1}


@pytest.mark.parametrize(
    ("change", "path", "said"),
    [
        ({"max": {"linear.q": 1.0}}, "gateway.safety[0].max.linear.q", 'did you mean "linear.'),
        ({"on_expiry": {"liner": {}}}, "gateway.safety[0].on_expiry", "liner"),
        ({"type": "my_msgs/msg/Drive", "max": {}}, "gateway.safety[0].type", "my_msgs/msg/Drive"),
    ],
)
async def test_fields_that_the_type_lacks(world: World, change: dict[str, Any], path: str, said: str) -> None:
    """A gateway with limits of fields that the type does not have does not come up, and says so with the path."""
    with pytest.raises(ConfigError) as caught:
        await world.gateway("robot", [], safety=[{**GUARD, **change}])
    ((found, text),) = caught.value.problems
    assert found == path
    assert said in text


@pytest.mark.parametrize(
    ("document", "path", "said"),
    [
        ({"gateway": {"safety": [GUARD, GUARD]}}, "gateway.safety[1]", "the same topic as gateway.safety[0]"),
        ({"gateway": {"safety": [GUARD], "workers": 2}}, "gateway.workers", "one process"),
        ({"gateway": {"safety": [{**GUARD, "graph": "dds:9"}]}}, "gateway.safety[0].graph", "expected one of"),
        ({"gateway": {"safety": [{**GUARD, "leas_s": 1}]}}, "gateway.safety[0].leas_s", 'did you mean "lease_s"'),
        (
            {"remotes": [{"address": "ws://a", "publish": [{**ROUTE, "safety": {"lease_s": 1.0}}]}]},
            "remotes[0].publish[0].safety",
            "only a topic that is subscribed",
        ),
        (
            {
                "gateway": {"safety": [GUARD]},
                "remotes": [{"address": "ws://a", "subscribe": [{**ROUTE, "safety": {"lease_s": 1.0}}]}],
            },
            "remotes[0].subscribe[0].safety",
            "the same topic as gateway.safety[0]",
        ),
    ],
)
def test_configurations_that_make_no_sense(document: dict[str, Any], path: str, said: str) -> None:
    """What makes no sense is told with its path before anything starts."""
    with pytest.raises(ConfigError) as caught:
        parse(document)
    assert said in dict(caught.value.problems)[path]
