"""Gateways that stand on ROS 2 through rclpy, among genuine nodes."""

from __future__ import annotations

from typing import Any

import pytest

from ropeway.gateway.config import config
from ropeway.gateway.gateway import Gateway
from tests.support.actions import FIBONACCI
from tests.support.messages import STRING
from tests.support.services import ADD
from tests.support.until import until

from .conftest import World

pytestmark = [pytest.mark.ros, pytest.mark.timeout(120)]

CALLS = "ros2_calls_peer.py"


async def joined(world: World, **routes: Any) -> int:
    """A cloud and a robot gateway, each on a ROS 2 network of its own; gives the cloud's domain."""
    far = world.domain + 40
    listening = {"name": "cloud", "graphs": [f"ros2:{far}"], "listen": ["ws://127.0.0.1:0"]}
    cloud = Gateway(config.parse({"gateway": listening, "remotes": []}))
    await world.stack.enter_async_context(cloud)
    port = cloud.servers[0].listeners[0].port
    operations = {name.replace("_", "-"): items for name, items in routes.items()}
    remote = {"address": f"ws://127.0.0.1:{port}", **operations}
    gateway = {"name": "robot", "graphs": ["ros2"], "listen": []}  # ROS_DOMAIN_ID is the robot's
    robot = Gateway(config.parse({"gateway": gateway, "remotes": [remote]}))
    await world.stack.enter_async_context(robot)
    return far


async def test_topics(world: World) -> None:
    """Live and latched topics of one network reach the nodes of another."""
    far = await joined(world, publish=[{"name": n, "type": STRING} for n in ("/live", "/latched")])
    await world.node("pub", "/live", STRING)
    await world.node("pub", "/latched", STRING, "--latched", "--count", "1", "--node", "l", "--text", "map")
    live = await world.node("sub", "/live", STRING, domain=far)
    late = await world.node("sub", "/latched", STRING, "--latched", "--node", "l", domain=far)
    await until(lambda: len(live.heard) >= 10 and late.heard)
    first = int(live.heard[0].split()[1])
    assert live.heard[:10] == [f"hello {i}" for i in range(first, first + 10)]
    assert late.heard == ["map 0"]


async def test_services_and_actions(world: World) -> None:
    """A service and an action of one network are used by nodes of another."""
    far = await joined(
        world,
        expose_service=[{"name": "/sum", "type": ADD}],
        expose_action=[{"name": "/fibonacci", "type": FIBONACCI}],
    )
    await world.node("serve", "/sum", program=CALLS)
    await world.node("act", "/fibonacci", program=CALLS)
    caller = await world.node("call", "/sum", "--count", "20", program=CALLS, domain=far)
    await until(lambda: any("right" in said for said in caller.said))
    assert caller.said[-1]["right"] == 20
    user = await world.node("goal", "/fibonacci", program=CALLS, domain=far)
    await until(lambda: any("status" in said for said in user.said))
    assert [said["status"] for said in user.said if "status" in said] == [4]
