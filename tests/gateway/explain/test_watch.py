"""Why a route passes nothing is known without being asked."""

from __future__ import annotations

import logging
from typing import Any

import pytest

from ropeway.gateway.explain.watch import RouteWatch
from ropeway.gateway.gateway import Gateway
from ropeway.gateway.route import RouteStatus
from ropeway.qos import QoS
from tests.support.inbox import Inbox
from tests.support.messages import STRING, sample
from tests.support.until import until
from tests.support.world import World, url

ODOMETRY = "nav_msgs/msg/Odometry"


async def gateway_with(world: World, *routes: dict[str, Any]) -> tuple[Gateway, RouteWatch]:
    """Make a connected gateway with these routes, and a watch of it."""
    cloud = await world.gateway("cloud", [])
    robot = await world.gateway("robot", [{"address": url(cloud), "publish": list(routes)}])
    await until(lambda: robot.remotes[0].state == "connected")
    return robot, RouteWatch(lambda: robot.remotes)


def told(robot: Gateway) -> RouteStatus:
    """Return how the first route is."""
    return robot.routes()[0]


def said(caplog: pytest.LogCaptureFixture) -> list[tuple[str, str]]:
    """Return what was logged about routes."""
    return [(r.levelname, r.getMessage()) for r in caplog.records if r.getMessage().startswith("publish /")]


async def test_another_type_is_an_error_at_once(world: World, caplog: pytest.LogCaptureFixture) -> None:
    """Another type on the network is logged at the first look, once, and is an error of the route."""
    caplog.set_level(logging.INFO)
    robot, watch = await gateway_with(world, {"name": "/odom", "type": STRING})
    here = await world.robot("robot")
    await here.create_publisher("/odom", ODOMETRY)
    for _ in range(5):
        watch.look()
    assert [level for level, _ in said(caplog)] == ["WARNING"]
    assert ODOMETRY in told(robot).error


async def test_a_misspelt_topic_is_told_after_a_while(
    world: World,
    caplog: pytest.LogCaptureFixture,
) -> None:
    """A topic that nobody publishes is logged when it stays so: with a near name as a warning."""
    caplog.set_level(logging.INFO)
    robot, watch = await gateway_with(world, {"name": "/odomm", "type": STRING})
    here = await world.robot("robot")
    watch.look()
    await here.create_publisher("/odom", STRING)
    watch.look()
    watch.look()
    assert said(caplog) == []
    assert "did you mean /odom?" in told(robot).reason
    assert told(robot).error == ""
    for _ in range(5):
        watch.look()
    assert [level for level, _ in said(caplog)] == ["WARNING"]


async def test_what_has_not_started_yet_is_no_warning(
    world: World,
    caplog: pytest.LogCaptureFixture,
) -> None:
    """A topic that nobody publishes, with nothing like it there, may come yet."""
    caplog.set_level(logging.INFO)
    _, watch = await gateway_with(world, {"name": "/odom", "type": STRING})
    here = await world.robot("robot")
    await here.create_publisher("/quite/another", STRING)
    for _ in range(5):
        watch.look()
    assert [level for level, _ in said(caplog)] == ["INFO"]


async def test_nobody_reads(world: World, caplog: pytest.LogCaptureFixture) -> None:
    """A topic that nobody reads is a reason, and no matter for the log."""
    caplog.set_level(logging.INFO)
    robot, watch = await gateway_with(world, {"name": "/odom", "type": STRING})
    here = await world.robot("robot")
    await here.create_publisher("/odom", STRING)
    for _ in range(5):
        watch.look()
    assert said(caplog) == []
    assert told(robot).reason.startswith("nobody reads /odom")


async def test_what_passes_has_no_reason(world: World) -> None:
    """A route on which messages pass has no reason."""
    robot, watch = await gateway_with(world, {"name": "/odom", "type": STRING})
    here, there = await world.robot("robot"), await world.robot("cloud")
    inbox = Inbox()
    publisher = await here.create_publisher("/odom", STRING)
    watch.look()
    await there.create_subscription("/odom", STRING, QoS(), inbox)
    await until(lambda: publisher.subscribers == 1)
    publisher.publish(sample("x"))
    await inbox.wait(1)
    watch.look()
    assert told(robot).reason == ""
