"""Routes of running gateways are explained on both ends."""

from __future__ import annotations

import asyncio
import re
from dataclasses import replace
from typing import Any

import pytest

from ropeway.bridge.topic import TopicBridge
from ropeway.gateway.explain import Explanation, Subject
from ropeway.gateway.gateway import Gateway
from ropeway.graph.link_parts import ToldByPeer
from ropeway.qos import DEFAULT, QoS
from tests.support.inbox import Inbox
from tests.support.messages import STRING, sample
from tests.support.until import until
from tests.support.world import World, url

ODOMETRY = "nav_msgs/msg/Odometry"
TOKEN = "for-tests-only"


def item(name: str, type: str = STRING, **more: Any) -> dict[str, Any]:
    """Make a route."""
    return {"name": name, "type": type, **more}


def failures(explanation: Explanation) -> dict[Subject, str]:
    """Return what is in the way."""
    return {finding.subject: finding.text for finding in explanation.findings if finding.ok is False}


async def only(gateway: Gateway, name: str, to: str = "") -> Explanation:
    """Explain what has one route."""
    (found,) = await gateway.explain(name, to)
    return found


async def connected(gateway: Gateway) -> None:
    """Wait for the links."""
    await until(lambda: all(remote.state == "connected" for remote in gateway.remotes))


async def test_what_crosses(world: World) -> None:
    """A topic that crosses has nothing in its way, from the publisher here to the reader there."""
    cloud = await world.gateway("cloud", [])
    robot = await world.gateway("robot", [{"address": url(cloud), "publish": [item("/chatter")]}])
    here, there = await world.robot("robot"), await world.robot("cloud")
    inbox = Inbox()
    await there.create_subscription("/chatter", STRING, QoS(), inbox)
    publisher = await here.create_publisher("/chatter", STRING)
    await until(lambda: publisher.subscribers == 1)
    publisher.publish(sample("hello"))
    await inbox.wait(1)
    found = await only(robot, "/chatter")
    assert found.crosses
    assert (found.source, found.target, found.path) == (here.name, url(cloud), "remotes[0].publish[0]")
    assert [finding.subject for finding in found.findings] == [
        Subject.SOURCE,
        Subject.TYPE,
        Subject.QOS,
        Subject.LINK,
        Subject.RIGHTS,
        Subject.READERS,
        Subject.TYPE,
        Subject.TRAFFIC,
    ]
    assert found.to_json()["findings"][-1]["text"].startswith("1 messages")


async def test_mistakes_of_the_configuration(world: World) -> None:
    """A misspelt name, another type and a QoS that nobody offers are each told."""
    cloud = await world.gateway("cloud", [])
    routes = [item("/odomm", ODOMETRY), item("/odom"), item("/scan", qos={"reliability": "reliable"})]
    robot = await world.gateway("robot", [{"address": url(cloud), "publish": routes}])
    here = await world.robot("robot")
    await here.create_publisher("/odom", ODOMETRY)
    await here.create_publisher("/scan", STRING, QoS(reliability="best_effort"))
    await connected(robot)
    assert "did you mean /odom?" in failures(await only(robot, "/odomm"))[Subject.SOURCE]
    assert f"published as {ODOMETRY}" in failures(await only(robot, "/odom"))[Subject.TYPE]
    assert "RELIABILITY" in failures(await only(robot, "/scan"))[Subject.QOS]


async def test_the_far_end(world: World) -> None:
    """The remote's half is asked over the link: who reads there, as what, or that nobody does."""
    cloud = await world.gateway("cloud", [])
    robot = await world.gateway("robot", [{"address": url(cloud), "publish": [item("/odom")]}])
    here, there = await world.robot("robot"), await world.robot("cloud")
    await here.create_publisher("/odom", STRING)
    await connected(robot)
    assert "nobody reads /odom" in failures(await only(robot, "/odom"))[Subject.READERS]
    await there.create_subscription("/odom", ODOMETRY, DEFAULT, lambda _: None)
    found = failures(await only(robot, "/odom"))
    assert f"read as {ODOMETRY}" in found[Subject.TYPE]
    assert "the route says" in found[Subject.TYPE]


async def test_the_other_way(world: World) -> None:
    """A topic that is fetched is looked for at the remote."""
    cloud = await world.gateway("cloud", [])
    robot = await world.gateway("robot", [{"address": url(cloud), "subscribe": [item("/cmd", remote_name="/cmd_vel")]}])
    here, there = await world.robot("robot"), await world.robot("cloud")
    await here.create_subscription("/cmd", STRING, QoS(), Inbox())
    await there.create_publisher("/cmd_val", STRING)
    await connected(robot)
    found = await only(robot, "/cmd_vel")
    assert found.target == here.name
    assert "did you mean /cmd_val?" in failures(found)[Subject.SOURCE]


async def test_what_the_far_end_passes_and_drops(world: World) -> None:
    """The remote tells how many messages of a route it has passed on, and how many it dropped, with the reason."""
    cloud = await world.gateway("cloud", [])
    limited = item("/fast", rate_hz=0.001)
    remote = {"address": url(cloud), "publish": [item("/odom")], "subscribe": [limited]}
    robot = await world.gateway("robot", [remote])
    here, there = await world.robot("robot"), await world.robot("cloud")
    await there.create_subscription("/odom", STRING, QoS(), Inbox())
    await here.create_subscription("/fast", STRING, QoS(), Inbox())
    odom, fast = await here.create_publisher("/odom", STRING), await there.create_publisher("/fast", STRING)
    await until(lambda: odom.subscribers and fast.subscribers)
    odom.publish(sample("a"))
    for number in range(5):
        fast.publish(sample(str(number)))

    async def told(name: str) -> str:
        while True:
            findings = (await only(robot, name)).findings
            texts = [found.text for found in findings if "have passed" in found.text]
            if texts:
                return texts[0]
            await asyncio.sleep(0.01)

    assert await told("/odom") == f"1 messages have passed {url(cloud)}"
    assert "which dropped 4 more often than the rate limit" in await told("/fast")


async def test_when_the_last_message_came(world: World) -> None:
    """A topic that has been silent for some seconds is told with the time since its last message, on both ends."""
    cloud = await world.gateway("cloud", [])
    robot = await world.gateway("robot", [{"address": url(cloud), "publish": [item("/odom")]}])
    here, there = await world.robot("robot"), await world.robot("cloud")
    await there.create_subscription("/odom", STRING, QoS(), Inbox())
    odom = await here.create_publisher("/odom", STRING)
    await until(lambda: odom.subscribers)
    bridge = robot.remotes[0].joined()[0].bridge
    assert isinstance(bridge, TopicBridge)
    odom.publish(sample("a"))
    await until(lambda: bridge.meter.passed_s and isinstance(bridge.publisher, ToldByPeer) and bridge.publisher.far)
    assert isinstance(bridge.publisher, ToldByPeer)
    assert bridge.publisher.far is not None
    assert bridge.meter.passed_s is not None
    bridge.meter.passed_s -= 60
    bridge.publisher.far = replace(bridge.publisher.far, passed_s=bridge.meter.passed_s)
    texts = [found.text for found in (await only(robot, "/odom")).findings if found.subject is Subject.TRAFFIC]
    assert len([text for text in texts if re.search(r", the last one 6\d s ago", text)]) == 2, texts


async def test_a_link_that_is_down(world: World) -> None:
    """A link that cannot be made is told with the reason, once."""
    robot = await world.gateway("robot", [{"address": "ws://127.0.0.1:1", "publish": [item("/odom")]}])
    here = await world.robot("robot")
    await here.create_publisher("/odom", STRING)
    await until(lambda: bool(robot.status()["remotes"][0]["error"]))
    found = failures(await only(robot, "/odom"))
    assert "refused" in found[Subject.LINK]
    assert Subject.RIGHTS not in found


@pytest.mark.parametrize("operation", ["publish", "subscribe"])
async def test_rights(
    world: World,
    monkeypatch: pytest.MonkeyPatch,
    operation: str,
) -> None:
    """What the remote denies is told with the rule that denies it."""
    monkeypatch.setenv("ROPEWAY_TEST_TOKEN", TOKEN)
    token = {"env": "ROPEWAY_TEST_TOKEN"}
    auth = {"tokens": [{"token": token, "role": "guest"}], "roles": {"guest": {"publish": ["/a"], "subscribe": ["/a"]}}}
    cloud = await world.gateway("cloud", [], auth=auth)
    robot = await world.gateway("robot", [{"address": url(cloud), "token": token, operation: [item("/secret")]}])
    here = await world.robot("robot")
    await here.create_publisher("/secret", STRING)
    await here.create_subscription("/secret", STRING, QoS(), Inbox())
    await connected(robot)
    await until(lambda: bool(robot.status()["routes"][0]["error"]))
    assert "guest" in failures(await only(robot, "/secret"))[Subject.RIGHTS]


async def test_services(world: World) -> None:
    """A service that nobody serves at the remote is told."""
    cloud = await world.gateway("cloud", [])
    service = item("/add", "example_interfaces/srv/AddTwoInts")
    robot = await world.gateway("robot", [{"address": url(cloud), "reserve-service": [service]}])
    there = await world.robot("cloud")
    await there.create_publisher("/other", STRING)
    await connected(robot)
    assert failures(await only(robot, "/add"))[Subject.SOURCE].startswith("nobody serves /add")


async def test_names_without_a_route(world: World) -> None:
    """A name that no route carries, and a remote that is not there, are told with the nearest."""
    cloud = await world.gateway("cloud", [])
    robot = await world.gateway("robot", [{"address": url(cloud), "title": "cloud", "publish": [item("/odom")]}])
    assert 'did you mean "/odom"?' in failures(await only(robot, "/odmo"))[Subject.ROUTE]
    assert "no remote is called clout" in failures(await only(robot, "/odom", "clout"))[Subject.ROUTE]
    assert (await only(robot, "/odom", "cloud")).path == "remotes[0].publish[0]"
