"""The status of a route."""

from __future__ import annotations

from ropeway.qos import QoS
from tests.support.inbox import Inbox
from tests.support.messages import STRING, joined, sample
from tests.support.until import until
from tests.support.world import World, url

ODOM = {"name": "/odom", "type": STRING}


async def test_the_same_until_something_changes(world: World) -> None:
    """A route that is as it was gives the very status that it gave before, and one that passes something another."""
    cloud = await world.gateway("cloud", [])
    robot = await world.gateway("robot", [{"address": url(cloud), "publish": [ODOM, {**ODOM, "name": "/quiet"}]}])
    here, there = await world.robot("robot"), await world.robot("cloud")
    inbox = Inbox()
    subscription = await there.create_subscription("/odom", STRING, QoS(), inbox)
    publisher = await here.create_publisher("/odom", STRING)
    await joined(publisher, read_by=[subscription])
    await until(lambda: robot.routes()[0].state == "active")
    before = robot.routes()
    publisher.publish(sample("here"))
    await inbox.wait(1)
    after = robot.routes()
    assert after[0].to_json()["messages"] == 1
    assert after[1] is before[1]


async def test_what_is_changed_in_a_row_stays_there(world: World) -> None:
    """A row of the table is the caller's own."""
    robot = await world.gateway("robot", [{"address": "ws://127.0.0.1:9", "publish": [ODOM]}])
    robot.routes()[0].to_json()["name"] = "/another"
    assert robot.routes()[0].to_json()["name"] == "/odom"


async def test_publishers_come_and_go(world: World) -> None:
    """Publishers on the side that a topic comes from are counted, but not the gateway's own."""
    cloud = await world.gateway("cloud", [])
    topics = {"publish": [ODOM], "subscribe": [{**ODOM, "name": "/back"}]}
    robot = await world.gateway("robot", [{"address": url(cloud), **topics}])
    here = await world.robot("robot")
    both = [await here.create_publisher("/odom", STRING) for _ in range(2)]
    assert robot.routes()[0].to_json()["publishers"] == 2
    await both[0].close()
    assert robot.routes()[0].to_json()["publishers"] == 1
    assert robot.routes()[1].to_json()["publishers"] == 0


async def test_calls(world: World) -> None:
    """The status of a service follows its calls."""
    cloud = await world.gateway("cloud", [])
    expose = {"expose-service": [{"name": "/enable", "type": "std_srvs/srv/SetBool"}]}
    robot = await world.gateway("robot", [{"address": url(cloud), **expose}])
    assert robot.routes()[0].to_json()["ended"] == {}
    bridge = robot.remotes[0].joined()[0].bridge
    bridge.done("answered", 0.5)
    row = robot.routes()[0].to_json()
    assert (row["requests"], row["ended"], row["took_ms"]) == (1, {"answered": 1}, 500.0)
