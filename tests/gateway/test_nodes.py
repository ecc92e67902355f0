"""IoRT nodes and stored topics of a gateway, as a user would have them."""

from __future__ import annotations

import asyncio
import contextlib
import json
import math
from collections.abc import AsyncIterator
from contextlib import AsyncExitStack
from pathlib import Path
from typing import Any

import pytest

from ropeway.errors import ConfigError
from ropeway.gateway.config import config
from ropeway.gateway.config.iort_model import robots
from ropeway.gateway.gateway import Gateway
from ropeway.gateway.last_value import LastValue
from ropeway.graph.base import Sample
from ropeway.iort import AsyncNode
from ropeway.listener import watchers
from ropeway.networks.memory.graph import MemoryGraph
from ropeway.networks.rosbridge.client import RosbridgeGraph
from ropeway.qos import LATCHED, QoS
from ropeway.types import TypeRegistry
from tests.iort.servers import Raw, serving
from tests.support.clock import Stopwatch
from tests.support.inbox import Inbox
from tests.support.messages import STRING, joined, sample, text
from tests.support.until import until
from tests.support.world import World

TWIST = "geometry_msgs/msg/Twist"
registry = TypeRegistry()
twists = registry.codec(TWIST)


@pytest.fixture
async def world() -> AsyncIterator[World]:
    async with AsyncExitStack() as stack:
        yield World(stack)


def nodes_port(gateway: Gateway) -> int:
    assert gateway.nodes is not None
    return gateway.nodes.server.listeners[0].port


async def with_nodes(world: World, maps: list[Any], **settings: Any) -> tuple[Gateway, MemoryGraph]:
    url = f"memory:{world.network('ros')}"
    given = {"name": "ros", "graphs": [url], "listen": ["iort://127.0.0.1:0", "ws://127.0.0.1:0"]}
    store = {"store": {"path": "memory:"}}
    gateway = Gateway(config.parse({"gateway": {**given, "iort": {"maps": maps}, **store, **settings}}))
    await world.stack.enter_async_context(gateway)
    return gateway, await world.robot("ros")


def twist(x: float = 0.0, z: float = 0.0) -> Sample:
    payload = twists.encode({"linear": {"x": x}, "angular": {"z": z}})
    return Sample(payload, TWIST, 0, bytes(16), 0)


def speeds(inbox: Inbox) -> list[tuple[float, float]]:
    found = [twists.decode(payload) for payload in inbox.payloads]
    return [(m["linear"]["x"], m["angular"]["z"]) for m in found]


async def test_node_drives_ros(world: World) -> None:
    """A packet of the paper moves a robot of ROS, and a Twist of ROS is read by a node of the paper."""
    gateway, robot = await with_nodes(world, ["turtlesim", "pepper"])
    inbox = Inbox()
    await robot.create_subscription("/TURTLESIM/cmd_vel", TWIST, QoS(), inbox)
    publisher = await robot.create_publisher("/PEPPER/cmd_vel", TWIST)
    node = await Raw.connect(nodes_port(gateway))
    await until(lambda: "/TURTLESIM/cmd_vel" in robot.topics())
    assert gateway.nodes is not None
    await until(lambda: all(b.state == "active" for b in gateway.nodes.bridges.values() if "TURTLE" in b.source_topic))
    node.send(b"%01/TURTLESIM/cmd_vel/p/0.2,0.0,0.0,0.0,0.0,0.5%")
    await inbox.wait(1)
    assert speeds(inbox) == [(0.2, 0.5)]
    await joined(publisher)
    publisher.publish(twist(0.1, -0.25))
    store = gateway.store
    assert store is not None
    await until(lambda: store.get("PEPPER", "cmd_vel") is not None)
    answer = await node.ask(b"%01/PEPPER/cmd_vel/s%")
    assert answer.data == b"0.1,0.0,0.0,0.0,0.0,-0.25"
    await node.close()


async def test_a_map_that_does_not_fit_fails_alone(world: World, caplog: pytest.LogCaptureFixture) -> None:
    """A map of a type that is not known, or without the fields it names, is told and left out; the others work."""
    bad = [
        {"system": "TURTLESIM", "topic": "odd", "type": "geometry_msgs/msg/Twistt"},
        {"system": "TURTLESIM", "topic": "off", "type": TWIST, "form": "floats", "fields": ["linear.q"]},
    ]
    gateway, robot = await with_nodes(world, [*bad, "turtlesim"])
    inbox = Inbox()
    await robot.create_subscription("/TURTLESIM/cmd_vel", TWIST, QoS(), inbox)
    node = await Raw.connect(nodes_port(gateway))
    assert gateway.nodes is not None
    await until(lambda: all(b.state == "active" for b in gateway.nodes.bridges.values() if "TURTLE" in b.source_topic))
    node.send(b"%01/TURTLESIM/cmd_vel/p/0.2,0.0,0.0,0.0,0.0,0.5%")
    await inbox.wait(1)
    await node.close()
    faults = gateway.nodes.status()["faults"]
    assert [fault.partition(":")[0] for fault in faults] == [
        "the map of TURTLESIM/odd is left out",
        "the map of TURTLESIM/off is left out",
    ]
    assert all(fault in caplog.text for fault in faults)


async def test_no_echo(world: World) -> None:
    """What comes from a node does not come back to it, and what comes from ROS does not come back there."""
    gateway, robot = await with_nodes(world, ["turtlesim"])
    url = f"iort://127.0.0.1:{nodes_port(gateway)}"
    inbox, values = Inbox(), list[str]()
    await robot.create_subscription("/TURTLESIM/cmd_vel", TWIST, QoS(), inbox)
    publisher = await robot.create_publisher("/TURTLESIM/cmd_vel", TWIST)
    await joined(publisher)
    async with AsyncNode("TURTLESIM", url) as node, AsyncNode("PC", url) as pc:
        await node.subscribe("cmd_vel", lambda value: values.append(value.text))
        await pc.publish("cmd_vel", [1, 0, 0, 0, 0, 0], system="TURTLESIM")
        await inbox.wait(1)
        publisher.publish(twist(2.0))
        await until(lambda: len(values) == 2)
        await pc.publish("cmd_vel", [3, 0, 0, 0, 0, 0], system="TURTLESIM")
        await inbox.wait(2)
    assert speeds(inbox) == [(1.0, 0.0), (3.0, 0.0)]
    assert [v.partition(",")[0] for v in values] == ["1.0", "2.0", "3.0"]


async def test_alice(world: World) -> None:
    """A Twist becomes Alice's codes and angles, and her codes and angles become a Twist and its end."""
    gateway, robot = await with_nodes(world, ["alice"])
    url = f"iort://127.0.0.1:{nodes_port(gateway)}"
    publisher = await robot.create_publisher("/ALICE/cmd_vel", TWIST)
    await joined(publisher)
    moves, angles = list[str](), list[float]()
    async with AsyncNode("ALICE", url) as node:
        await node.subscribe("NAVI_ROBOT_MOVE_REQ", lambda v: moves.append(v.text))
        await node.subscribe("NAVI_GO_ROTATION_REQ", lambda v: angles.append(float(v.text)))
        for message in (twist(0.3), twist(-0.3), twist(0.0)):
            publisher.publish(message)
            await until(lambda: moves)
        await until(lambda: moves == ["0", "1", "4"])
        watch = Stopwatch()
        publisher.publish(twist(0.0, math.radians(90)))
        await asyncio.sleep(0.5)  # the angle grows with the time
        publisher.publish(twist(0.0, 0.0))
        await until(lambda: sum(angles) >= 40)
        assert sum(angles) <= 90 * watch.seconds + 1
        inbox = Inbox()
        await robot.create_subscription("/ALICE/cmd_vel", TWIST, QoS(), inbox)
        assert gateway.nodes is not None
        await until(lambda: gateway.nodes.bridges["in", "/ALICE/cmd_vel"].state == "active")
        async with AsyncNode("PC", url) as pc:
            await pc.publish("NAVI_ROBOT_MOVE_REQ", "1", system="ALICE")
            await inbox.wait(1)
            await pc.publish("NAVI_GO_ROTATION_REQ", "-10", system="ALICE")
            await inbox.wait(3)
            await pc.publish("NAVI_ROBOT_MOVE_REQ", "dance", system="ALICE")
            await until(lambda: sum(gateway.nodes.graph.drops.values()) == 1)
    assert speeds(inbox) == [(-0.2, 0.0), (0.0, -0.5), (0.0, 0.0)]


async def test_one_command_for_all(world: World) -> None:
    """What one node publishes reaches every robot that a map gives the same name in ROS, in the robot's own form."""
    pc = {"system": "PC", "topic": "cmd_vel", "type": TWIST, "form": "floats", "name": "/cmd_vel", "direction": "in"}
    codes = {"0": {"linear.x": 0.2}, "1": {"linear.x": -0.2}, "4": {}}
    alice = {"system": "ALICE", "topic": "MOVE", "type": TWIST, "form": "codes", "codes": codes, "name": "/cmd_vel"}
    pepper = {"system": "PEPPER", "topic": "cmd_vel", "type": TWIST, "form": "floats", "name": "/cmd_vel"}
    gateway, robot = await with_nodes(world, [pc, {**alice, "direction": "out"}, {**pepper, "direction": "out"}])
    inbox = Inbox()
    await robot.create_subscription("/cmd_vel", TWIST, QoS(), inbox)
    assert gateway.nodes is not None
    nodes = gateway.nodes
    await until(lambda: all(bridge.state == "active" for bridge in nodes.bridges.values()))
    node = await Raw.connect(nodes_port(gateway))
    node.send(b"%01/PC/cmd_vel/p/-0.5,0,0,0,0,0%")
    await inbox.wait(1)
    store = gateway.store
    assert store is not None
    await until(lambda: {e.system: e.text for e in store.entries()}.keys() == {"PC", "ALICE", "PEPPER"})
    assert (await node.ask(b"%01/ALICE/MOVE/s%")).data == b"1"
    assert (await node.ask(b"%01/PEPPER/cmd_vel/s%")).data == b"-0.5,0.0,0.0,0.0,0.0,0.0"
    await node.close()


async def test_patterns(world: World) -> None:
    """A map with a pattern shares every topic that a node publishes or reads, under names that ROS allows."""
    gateway, robot = await with_nodes(world, [{"system": "PEPPER", "topic": "*"}])
    url = f"iort://127.0.0.1:{nodes_port(gateway)}"
    async with AsyncNode("PEPPER", url) as node:
        await node.publish("battery-level", "80")
        await until(lambda: "/PEPPER/battery_level" in robot.topics())
        inbox = Inbox()
        await robot.create_subscription("/PEPPER/battery_level", STRING, QoS(), inbox)
        assert gateway.nodes is not None
        await until(lambda: gateway.nodes.bridges["in", "/PEPPER/battery_level"].state == "active")
        await node.publish("battery-level", "79")
        await inbox.wait(1)
        assert inbox.payloads == [text("79")]
        said: list[str] = []
        await node.subscribe("say", lambda value: said.append(value.text))
        publisher = await robot.create_publisher("/PEPPER/say", STRING)
        await until(lambda: ("out", "/PEPPER/say") in gateway.nodes.bridges)
        await joined(publisher)
        publisher.publish(sample("hello"))
        await until(lambda: said == ["hello"])


async def test_json_fields(world: World) -> None:
    """A JSON value and a message are joined field by field."""
    fields = {"percentage": "battery.level", "voltage": "battery.volt"}
    map = {"system": "A", "topic": "state", "type": "sensor_msgs/BatteryState", "form": "json", "fields": fields}
    gateway, robot = await with_nodes(world, [map])
    inbox = Inbox()
    await robot.create_subscription("/A/state", "sensor_msgs/msg/BatteryState", QoS(), inbox)
    assert gateway.nodes is not None
    await until(lambda: gateway.nodes.bridges["in", "/A/state"].state == "active")
    async with AsyncNode("A", f"iort://127.0.0.1:{nodes_port(gateway)}") as node:
        await node.publish("state", {"battery": {"level": 0.5, "volt": 24}, "other": 1})
        (got,) = await inbox.wait(1)
    message = registry.codec("sensor_msgs/msg/BatteryState").decode(bytes(got.payload))
    assert (message["percentage"], message["voltage"]) == (0.5, 24.0)


async def test_old_commands_do_not_move(world: World) -> None:
    """A driver that starts late does not get the last command of a node, unless the map has it latched."""
    gateway, robot = await with_nodes(world, ["pepper", {"system": "PEPPER", "topic": "map", "latched": True}])
    async with AsyncNode("PEPPER", f"iort://127.0.0.1:{nodes_port(gateway)}") as node:
        await node.publish("cmd_vel", [1, 0, 0, 0, 0, 0])
        await node.publish("map", "the map")
        late, inbox = Inbox(), Inbox()
        await robot.create_subscription("/PEPPER/cmd_vel", TWIST, QoS(), late)
        await robot.create_subscription("/PEPPER/map", STRING, LATCHED, inbox)
        await inbox.wait(1)
        assert inbox.payloads == [text("the map")]
        assert gateway.nodes is not None
        await until(lambda: gateway.nodes.bridges["in", "/PEPPER/cmd_vel"].state == "active")
        await node.publish("cmd_vel", [2, 0, 0, 0, 0, 0])
        await late.wait(1)
        assert speeds(late) == [(2.0, 0.0)]


async def test_stored_topic(world: World, tmp_path: Path) -> None:
    """A topic with "store": true gives late joiners its last message, also after a restart and without its source."""
    far = await world.gateway("far", [])
    robot = await world.robot("far")
    source = await robot.create_publisher("/robot1/odom", STRING, QoS(reliability="best_effort"))
    port = far.servers[0].listeners[0].port
    route = {"name": "/robot1/odom", "type": STRING, "store": True}
    near = {
        "gateway": {
            "name": "near",
            "graphs": [f"memory:{world.network('near')}"],
            "listen": ["ws://127.0.0.1:0"],
            "store": {"path": str(tmp_path / "s.sqlite")},
        },
        "remotes": [{"address": f"ws://127.0.0.1:{port}", "subscribe": [route]}],
    }
    reader = await world.robot("near")
    async with Gateway(config.parse(near)) as gateway:
        await joined(source)
        source.publish(sample("here I am"))
        store = gateway.store
        assert store is not None
        await until(lambda: store.get("robot1", "odom") is not None)
        inbox = Inbox()
        await reader.create_subscription("/robot1/odom", STRING, LATCHED, inbox)
        await inbox.wait(1)
        assert inbox.payloads == [text("here I am")]
    await source.close()
    await asyncio.sleep(0.05)
    async with Gateway(config.parse(near)):
        late = Inbox()
        await reader.create_subscription("/robot1/odom", STRING, LATCHED, late)
        (got,) = await late.wait(1)
        assert bytes(got.payload) == text("here I am")
        assert got.stamp_ns == inbox.samples[0].stamp_ns


async def test_stored_topic_for_web_clients(world: World) -> None:
    """A rosbridge client that comes late gets the last message of a stored topic, though its source latches nothing."""
    far = await world.gateway("far", [])
    robot = await world.robot("far")
    source = await robot.create_publisher("/battery", STRING)
    remote = {
        "address": f"ws://127.0.0.1:{far.servers[0].listeners[0].port}",
        "subscribe": [{"name": "/battery", "type": STRING, "store": True}],
    }
    near = await world.gateway("near", [remote], store={"path": "memory:"})
    await joined(source)
    source.publish(sample("80"))
    store = near.store
    assert store is not None
    await until(lambda: store.get("near", "battery") is not None)
    client = RosbridgeGraph(f"ws://127.0.0.1:{near.servers[0].listeners[0].port}", registry=registry, plain=True)
    await client.open()
    inbox = Inbox()
    await client.create_subscription("/battery", STRING, None, inbox)
    await inbox.wait(1)
    assert inbox.payloads == [text("80")]
    await client.close()


async def http(port: int, path: str, method: str = "GET") -> tuple[int, Any]:
    reader, writer = await asyncio.open_connection("127.0.0.1", port)
    writer.write(f"{method} {path} HTTP/1.1\r\nHost: localhost\r\n\r\n".encode())
    raw = await reader.read()
    writer.close()
    head, _, body = raw.partition(b"\r\n\r\n")
    return int(head.split()[1]), json.loads(body) if body.startswith((b"{", b"[")) else body


async def test_http(world: World) -> None:
    """Values are listed, read with their age, watched and removed over HTTP, as text or as messages."""
    gateway, _ = await with_nodes(world, ["pepper"], store={"path": "memory:", "history": 2})
    port = gateway.servers[0].listeners[0].port
    url = f"iort://127.0.0.1:{nodes_port(gateway)}"
    async with AsyncNode("PEPPER", url) as node:
        await node.publish("battery", "80")
        await node.publish("battery", "79")
        await node.publish("odd/topic", b"\xff")
        status, value = await http(port, "/store/PEPPER/battery")
        assert (status, value["data"], value["system"]) == (200, "79", "PEPPER")
        assert 0 <= value["age_s"] < 5
        assert [v["data"] for v in (await http(port, "/store/PEPPER/battery?history=1"))[1]] == ["79", "80"]
        assert (await http(port, "/store/PEPPER/odd/topic?raw=1"))[1] == b"\xff"
        assert [v["topic"] for v in (await http(port, "/store"))[1]] == ["battery", "odd/topic"]
        assert (await http(port, "/store/NOBODY/x"))[0] == 404
        assert (await http(port, "/store/PEPPER/x"))[1] == {"error": "no value of PEPPER/x is there", "missing": True}
        assert (await http(port, "/store/PEPPER", "DELETE"))[0] == 400
        assert (await http(port, "/store/PEPPER/battery", "PUT"))[0] == 405
        reader, writer = await asyncio.open_connection("127.0.0.1", port)
        writer.write(b"GET /store/PEPPER/battery?watch=1 HTTP/1.1\r\nHost: localhost\r\n\r\n")
        await reader.readuntil(b"\r\n\r\n")
        assert json.loads(await reader.readline())["data"] == "79"
        await node.publish("battery", "78")
        assert json.loads(await reader.readline())["data"] == "78"
        assert (await http(port, "/store/PEPPER/battery", "DELETE")) == (200, {"removed": True})
        assert json.loads(await reader.readline())["removed"] is True
        writer.close()
        assert (await http(port, "/store/PEPPER/battery", "DELETE"))[0] == 404


async def test_http_watchers(world: World, tmp_path: Path) -> None:
    """Watchers count as clients, and end when their token is gone."""
    token = tmp_path / "token"
    token.write_text("first")
    auth = {"tokens": [{"token": {"file": str(token)}}]}
    gateway, _ = await with_nodes(world, [], store={"path": "memory:"}, auth=auth, clients={"max_clients": 1})
    port = gateway.servers[0].listeners[0].port
    ask = b"GET /store?watch=1&token=first HTTP/1.1\r\nHost: localhost\r\n\r\n"
    reader, writer = await asyncio.open_connection("127.0.0.1", port)
    writer.write(ask)
    assert b" 200 " in await reader.readuntil(b"\r\n\r\n")
    second, other = await asyncio.open_connection("127.0.0.1", port)
    other.write(ask)
    assert b" 503 " in await second.readuntil(b"\r\n\r\n")
    token.write_text("second")
    gateway.reload()
    with contextlib.suppress(ConnectionError):
        assert await reader.read() == b""
    await until(lambda: not gateway.servers[0].watchers)
    writer.close()
    other.close()


async def test_http_watchers_of_one_address(world: World, monkeypatch: pytest.MonkeyPatch) -> None:
    """One address without a token cannot take all places of watchers; others come in, and it once one has left."""
    monkeypatch.setattr(watchers, "WATCHERS_PER_ADDRESS", 2)
    gateway, _ = await with_nodes(world, [], store={"path": "memory:"}, insecure=True, listen=["ws://0.0.0.0:0"])
    port = gateway.servers[0].listeners[0].port
    came = []

    async def watch(source: str) -> bytes:
        reader, writer = await asyncio.open_connection("127.0.0.1", port, local_addr=(source, 0))
        came.append(writer)
        writer.write(b"GET /store?watch=1 HTTP/1.1\r\nHost: localhost\r\n\r\n")
        return (await reader.readuntil(b"\r\n\r\n")).split()[1]

    assert [await watch("127.0.0.2") for _ in range(3)] == [b"200", b"200", b"503"]
    assert await watch("127.0.0.3") == b"200"
    came[0].close()
    await until(lambda: len(gateway.servers[0].watchers) == 2)
    assert await watch("127.0.0.2") == b"200"
    for writer in came:
        writer.close()
    await until(lambda: not gateway.servers[0].watchers)


async def test_http_roles(world: World, monkeypatch: pytest.MonkeyPatch) -> None:
    """Over HTTP the roles of the configuration decide, as for clients."""
    monkeypatch.setenv("TOKEN", "secret")
    auth = {
        "tokens": [{"token": {"env": "TOKEN"}, "role": "reader"}],
        "roles": {"reader": {"subscribe": ["/PEPPER/*"]}},
    }
    gateway, _ = await with_nodes(world, [], auth=auth)
    port = gateway.servers[0].listeners[0].port
    assert gateway.nodes is not None
    for system in ("PEPPER", "ALICE"):
        gateway.nodes.space.publish(None, system, "x", b"1", origin="test")
    assert (await http(port, "/store"))[0] == 401
    assert [v["system"] for v in (await http(port, "/store?token=secret"))[1]] == ["PEPPER"]
    assert (await http(port, "/store/ALICE/x?token=secret"))[0] == 403
    assert (await http(port, "/store/PEPPER/x?token=secret", "DELETE"))[0] == 403


async def test_messages_for_nodes(world: World) -> None:
    """A stored message of ROS is text for nodes: by its map, or as JSON."""
    gateway, _ = await with_nodes(world, ["pepper"])
    assert gateway.store is not None
    LastValue(gateway.store, "PEPPER", "cmd_vel", TWIST).put(twist(1.0))
    LastValue(gateway.store, "robot1", "chat", STRING).put(sample("hi"))
    node = await Raw.connect(nodes_port(gateway))
    assert (await node.ask(b"%01/PEPPER/cmd_vel/s%")).data == b"1.0,0.0,0.0,0.0,0.0,0.0"
    assert (await node.ask(b"%01/robot1/chat/s%")).data == b"hi"
    await node.close()


async def test_remote_server(world: World) -> None:
    """A server of nodes elsewhere is a remote like others: topics are published to it and fetched from it."""
    async with serving() as served:
        remote = {
            "address": served.url,
            "maps": ["turtlesim"],
            "publish": [{"name": "/TURTLESIM/cmd_vel", "type": TWIST}],
            "subscribe": [{"name": "/PEPPER/battery", "type": STRING}],
        }
        gateway = await world.gateway("ros", [remote])
        robot = await world.robot("ros")
        inbox = Inbox()
        await robot.create_subscription("/PEPPER/battery", STRING, QoS(), inbox)
        publisher = await robot.create_publisher("/TURTLESIM/cmd_vel", TWIST)
        await joined(publisher)
        await until(lambda: [row["state"] for row in gateway.status()["routes"]] == ["active", "active"])
        publisher.publish(twist(0.5))
        await until(lambda: served.store.get("TURTLESIM", "cmd_vel") is not None)
        node = await Raw.connect(served.port)
        assert (await node.ask(b"%01/TURTLESIM/cmd_vel/s%")).data == b"0.5,0.0,0.0,0.0,0.0,0.0"
        node.send(b"%01/PEPPER/battery/p/80%")
        await inbox.wait(1)
        assert inbox.payloads == [text("80")]
        await node.close()
    await until(lambda: gateway.status()["remotes"][0]["state"] == "connecting")


async def test_status(world: World) -> None:
    """The status tells of nodes, bridges and values, and of what was refused."""
    gateway, _ = await with_nodes(world, ["pepper"])
    node = await Raw.connect(nodes_port(gateway))
    node.send(b"%nonsense%%01/PEPPER/cmd_vel/p/1,2%")
    await until(lambda: gateway.status()["nodes"]["values"] == 1)
    status = gateway.status()
    assert status["nodes"]["counts"]["malformed"] == 1
    assert status["store"]["values"] == 1
    assert {row["name"] for row in status["nodes"]["bridges"]} == {"/PEPPER/cmd_vel"}
    assert gateway.missing() == []
    await node.close()


def test_robots() -> None:
    """The maps of the paper's five robots come with the package, and fit their types."""
    assert sorted(robots()) == ["alice", "pepper", "rutas", "turtlebot4", "turtlesim"]
    parsed = config.parse({"gateway": {"iort": {"maps": sorted(robots())}}})
    for item in parsed.gateway.iort.maps:
        item.as_map().make_form(registry)
    again = config.parse(parsed.to_json())
    assert again.gateway.iort == parsed.gateway.iort


@pytest.mark.parametrize(
    ("gateway", "said"),
    [
        ({"iort": {"maps": ["alise"]}}, 'did you mean "alice"'),
        ({"iort": {"maps": [{"system": "A", "topic": "b", "form": "codes"}]}}, 'needs "codes"'),
        ({"iort": {"maps": [{"system": "*", "topic": "b", "name": "/x"}]}}, "cannot have one name"),
        ({"iort": {"maps": [{"system": "A", "topic": "b", "type": "Twist"}]}}, "pkg/msg/Name"),
        ({"listen": ["iort://127.0.0.1"], "workers": 2}, "need one process"),
        ({"listen": ["iort://0.0.0.0"]}, "without authentication"),
        ({"listen": ["iorts://127.0.0.1"]}, "iorts:// listener needs gateway.tls"),
        ({"store": {"max_value_bytes": 0}}, "expected a number from 1"),
    ],
)
def test_faults(gateway: dict[str, Any], said: str) -> None:
    """A configuration that cannot work says where and why."""
    with pytest.raises(ConfigError, match=said.replace("(", r"\(")):
        config.parse({"gateway": gateway})


def test_faults_of_remotes() -> None:
    """A server of nodes has topics only, and maps are for servers of nodes."""
    with pytest.raises(ConfigError, match="neither services nor actions"):
        config.parse([{"address": "iort://h", "expose-service": [{"name": "/a", "type": "std_srvs/Trigger"}]}])
    with pytest.raises(ConfigError, match="needs an iort:// address"):
        config.parse([{"address": "ws://h", "maps": ["alice"]}])


def test_maps_of_files(tmp_path: Path) -> None:
    """Maps may stand in files beside the configuration; a fault says which item and which map of the file."""
    (tmp_path / "mine.yaml").write_text("- {system: MINE, topic: a}\n- {system: MINE, topic: b, form: floats}\n")
    (tmp_path / "bad.json").write_text('{"maps": [{"system": "A", "topic": "b"}, {"system": "A", "topics": "c"}]}')
    item = {"system": "A", "topic": "b", "direction": "out"}
    made = config.parse({"gateway": {"iort": {"maps": ["alice", "mine.yaml", item]}}}, directory=tmp_path)
    assert [map.system for map in made.gateway.iort.maps] == ["ALICE", "ALICE", "MINE", "MINE", "A"]
    with pytest.raises(ConfigError) as told:
        config.parse(
            {"gateway": {"iort": {"maps": ["alice", "bad.json", {**item, "form": "jsno"}]}}}, directory=tmp_path
        )
    problems = dict(told.value.problems)
    assert problems["gateway.iort.maps[1]"].startswith("bad.json: map 1: topic")
    assert problems["gateway.iort.maps[2].form"].endswith('did you mean "json"?')


async def test_values_that_do_not_fit_are_told(world: World, caplog: pytest.LogCaptureFixture) -> None:
    """A value that its map cannot convert is counted, and told once with its topic and the reason."""
    maps = [{"system": "PEPPER", "topic": "cmd_vel", "type": TWIST, "form": "floats"}]
    gateway, robot = await with_nodes(world, maps)
    inbox = Inbox()
    await robot.create_subscription("/PEPPER/cmd_vel", TWIST, None, inbox)
    async with AsyncNode("PEPPER", f"iort://127.0.0.1:{nodes_port(gateway)}") as node:
        await until(lambda: node.mode == "remote")
        for _ in range(3):
            await node.publish("cmd_vel", "hello")
        assert gateway.nodes is not None
        drops = gateway.nodes.graph.drops
        await until(lambda: sum(drops.values()) == 3)
    told = [line for line in caplog.messages if "PEPPER/cmd_vel" in line]
    assert len(told) == 1
    assert "bad value on PEPPER/cmd_vel: it is not passed on to /PEPPER/cmd_vel" in told[0]
