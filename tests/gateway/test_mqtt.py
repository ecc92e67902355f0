"""A gateway and an MQTT broker, as a user would have them."""

from __future__ import annotations

import json
from collections.abc import AsyncIterator, Iterator
from contextlib import AsyncExitStack
from pathlib import Path
from typing import Any

import pytest

from ropeway.errors import ConfigError
from ropeway.gateway.config import config
from ropeway.gateway.credentials import read_credentials
from ropeway.gateway.gateway import Gateway
from ropeway.networks.memory.graph import MemoryGraph
from ropeway.qos import LATCHED, QoS
from ropeway.types import TypeRegistry
from tests.networks.mqtt.broker import HAS_BROKER, WHY_NOT, Broker
from tests.networks.mqtt.device import Device
from tests.support.inbox import Inbox
from tests.support.messages import sample
from tests.support.until import until
from tests.support.world import World

pytestmark = pytest.mark.skipif(not HAS_BROKER, reason=WHY_NOT)

ODOMETRY, TWIST = "nav_msgs/msg/Odometry", "geometry_msgs/msg/Twist"
registry = TypeRegistry()


@pytest.fixture
async def world() -> AsyncIterator[World]:
    async with AsyncExitStack() as stack:
        yield World(stack)


@pytest.fixture
def broker() -> Iterator[Broker]:
    with Broker() as started:
        yield started


async def running(world: World, remote: dict[str, Any], **settings: Any) -> tuple[Gateway, MemoryGraph]:
    given = {"name": "robot1", "graphs": [f"memory:{world.network('robot1')}"], "listen": [], **settings}
    gateway = Gateway(config.parse({"gateway": given, "remotes": [remote]}))
    await world.stack.enter_async_context(gateway)
    return gateway, await world.robot("robot1")


async def test_routes(world: World, broker: Broker) -> None:
    """A robot's odometry goes to a topic of the broker, and what a device publishes becomes a ROS topic."""
    remote = {
        "address": broker.url,
        "topics": [{"topic": "factory/robot-1/drive", "type": TWIST, "form": "floats", "name": "/drive"}],
        "publish": [{"name": "/odom", "type": ODOMETRY, "remote_name": "/factory/robot1/odom"}],
        "subscribe": [{"name": "/cmd_vel", "type": TWIST, "remote_name": "/drive"}],
    }
    gateway, robot = await running(world, remote)
    device = world.stack.enter_context(Device(broker, "factory/#"))
    publisher = await robot.create_publisher("/odom", ODOMETRY)
    await until(lambda: publisher.subscribers)
    message = sample("", ODOMETRY)
    message.payload = registry.codec(ODOMETRY).encode({"child_frame_id": "base"})
    publisher.publish(message)
    await until(lambda: device.got)
    ((topic, payload),) = device.got
    assert (topic, json.loads(payload)["child_frame_id"]) == ("factory/robot1/odom", "base")
    inbox = Inbox()
    await robot.create_subscription("/cmd_vel", TWIST, QoS(), inbox)
    await until(lambda: any("drive" in feed.filter for feed in gateway.remotes[0].graph._feeds))  # type: ignore[attr-defined]
    await until(lambda: gateway.remotes[0].state == "connected")
    device.publish("factory/robot-1/drive", "0.5,0,0,0,0,1")
    (got,) = await inbox.wait(1)
    assert registry.codec(TWIST).decode(got.payload)["angular"]["z"] == 1.0
    (status,) = [remote.status() for remote in gateway.remotes]
    assert (status["state"], status["error"], status["address"]) == ("connected", "", broker.url)


async def test_retained(world: World, broker: Broker) -> None:
    """A value that the broker keeps reaches late joiners in ROS."""
    world.stack.enter_context(Device(broker)).publish("state", "kept", retain=True)
    remote = {"address": broker.url, "subscribe": [{"name": "/state", "type": "std_msgs/msg/String"}]}
    _, robot = await running(world, remote)
    inbox = Inbox()
    await until(lambda: "/state" in robot.topics() and robot.topics()["/state"].publishers[0].qos.transient_local)
    await robot.create_subscription("/state", "std_msgs/msg/String", LATCHED, inbox)
    await inbox.wait(1)
    assert inbox.texts == ["kept"]


async def test_broker_that_comes_later(world: World) -> None:
    """A gateway starts without its broker, tells why there is no connection, and connects when it is there."""
    broker = Broker()
    gateway, _ = await running(world, {"address": broker.url, "publish": [{"name": "/t", "type": ODOMETRY}]})
    await until(lambda: "cannot be reached" in gateway.remotes[0].status()["error"])
    with broker:
        await until(lambda: gateway.remotes[0].state == "connected")


async def test_broker_as_a_local_network(world: World, broker: Broker) -> None:
    """The topics of a broker can be the local network of a gateway, with maps of their own."""
    topics = [{"topic": "temp", "type": "std_msgs/msg/Float64"}]
    given = {"name": "edge", "graphs": [{"address": broker.url, "topics": topics}], "listen": ["ws://127.0.0.1:0"]}
    gateway = Gateway(config.parse({"gateway": given, "remotes": []}))
    await world.stack.enter_async_context(gateway)
    world.stack.enter_context(Device(broker)).publish("temp", "21.5", retain=True)
    view = next(iter(gateway.hubs.values())).view("test")
    await until(lambda: view.topics()["/temp"].type == "std_msgs/msg/Float64")


def test_password_of_a_file(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """The password of a user is read from a file or the environment, and a missing one is told with its place."""
    file = tmp_path / "password"
    for text in ("", "right\n"):
        file.write_text(text)
        remote = {"address": "mqtts://broker.example", "user": "robot1", "password": {"file": str(file)}}
        parsed = config.parse({"gateway": {"listen": []}, "remotes": [remote]})
        if text:
            credentials = read_credentials(parsed.remotes[0], 0)
            assert credentials.password == "right"
            assert "right" not in repr(credentials)
        else:
            with pytest.raises(ConfigError, match=r"remotes\[0\]\.password\.file: expected"):
                read_credentials(parsed.remotes[0], 0)
    monkeypatch.delenv("NO_PASSWORD", raising=False)
    remote["password"] = {"env": "NO_PASSWORD"}
    parsed = config.parse({"gateway": {"listen": []}, "remotes": [remote]})
    with pytest.raises(ConfigError, match="NO_PASSWORD is not set"):
        read_credentials(parsed.remotes[0], 0)


@pytest.mark.parametrize(
    ("remote", "where", "said"),
    [
        ({"address": "mqtt://user:secret@host"}, "address", "holds no"),
        ({"address": "mqtt://host/path"}, "address", "without a path"),
        ({"address": "mqtt://host?discover=a/%23/b"}, "address", "# stands alone"),
        ({"address": "mqtt://host?what=1"}, "address", "not an option"),
        ({"address": "mqtt://host", "tls": {}}, "tls", "needs a mqtts:// address"),
        ({"address": "mqtt://host", "token": {"env": "X"}}, "token", "a user and a password"),
        ({"address": "mqtt://host", "password": {"env": "X"}}, "user", "missing"),
        ({"address": "ws://host", "user": "x"}, "user", "needs an mqtt://"),
        ({"address": "ws://host", "topics": [{"topic": "a"}]}, "topics", "needs an mqtt://"),
        ({"address": "mqtt://host", "topics": [{"topic": "a/#/b"}]}, "topics[0].topic", "# stands alone"),
        ({"address": "mqtt://host", "topics": [{"topic": "a/+", "name": "/a"}]}, "topics[0]", '"direction": "in"'),
        ({"address": "mqtt://host", "topics": [{"topic": "a", "form": "raw"}]}, "topics[0]", "the form raw is for"),
        (
            {"address": "mqtt://host", "expose-service": [{"name": "/s", "type": "std_srvs/srv/Trigger"}]},
            "expose-service",
            "neither services nor actions",
        ),
    ],
    ids=range(13),
)
def test_what_is_refused(remote: dict[str, Any], where: str, said: str) -> None:
    """What a broker does not have, or only a broker has, is refused where it stands, and no password is shown."""
    with pytest.raises(ConfigError) as caught:
        config.parse({"gateway": {"listen": []}, "remotes": [remote]})
    assert any(path == f"remotes[0].{where}" and said in text for path, text in caught.value.problems)
    assert "secret" not in str(caught.value)
