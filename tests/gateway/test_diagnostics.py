"""Links and routes are told as ROS diagnostics."""

from __future__ import annotations

from typing import Any

from ropeway.gateway.diagnostics import TOPIC, TYPE, statuses
from ropeway.qos import QoS
from ropeway.types import TypeRegistry
from tests.support.inbox import Inbox
from tests.support.messages import STRING
from tests.support.world import World

LINK: dict[str, Any] = {"address": "ws://cloud:9090", "state": "connected", "rtt_ms": 70.0, "pace_bps": None}
ROUTE: dict[str, Any] = {"operation": "publish", "name": "/odom", "state": "active", "error": "", "rate_hz": 30.0}


def levels(*rows: dict[str, Any]) -> list[int]:
    """Return the levels of routes."""
    return [
        found["level"] for found in statuses("robot1", {"remotes": [], "routes": [{**ROUTE, **row} for row in rows]})
    ]


def test_what_is_told() -> None:
    """A status has the state with its reason, and the figures as texts."""
    link, route = statuses(
        "robot1", {"remotes": [LINK], "routes": [{**ROUTE, "reason": "nobody reads", "drops": {"late": 2}}]}
    )
    assert link == {
        "level": 0,
        "name": "robot1: link ws://cloud:9090",
        "message": "connected",
        "hardware_id": "robot1",
        "values": [{"key": "rtt_ms", "value": "70.0"}],
    }
    assert route["name"] == "robot1: publish /odom"
    assert route["message"] == "active: nobody reads"
    assert {"key": "dropped: late", "value": "2"} in route["values"]


def test_levels() -> None:
    """What has failed is an error, what waits a warning; a topic that nobody reads is all right."""
    failed, waiting, idle = {"state": "failed", "error": "refused"}, {"state": "waiting"}, {"state": "idle"}
    assert levels({}, failed, waiting, idle, {"error": "another type"}) == [0, 2, 1, 0, 2]


async def test_on_the_robots_network(world: World) -> None:
    """Where asked for, the gateway publishes them on its network."""
    remote = {"address": "ws://127.0.0.1:1", "publish": [{"name": "/odom", "type": STRING}]}
    await world.gateway("robot", [remote], diagnostics=True)
    here, inbox = await world.robot("robot"), Inbox()
    await here.create_subscription(TOPIC, TYPE, QoS(), inbox)
    await inbox.wait(1)
    message = TypeRegistry().codec(TYPE).decode(inbox.payloads[0])
    assert [status["name"] for status in message["status"]] == [
        "robot: link ws://127.0.0.1:1",
        "robot: publish /odom",
    ]
    assert message["header"]["stamp"]["sec"] > 0
