"""Networks of other distributions over DDS, beside one of ours in the same process."""

from __future__ import annotations

import logging
from pathlib import Path

import pytest

from ropeway.graph.base import SEQ_NONE, Sample, new_origin
from ropeway.graph.calls import Request
from ropeway.networks.dds import DdsGraph
from ropeway.types import TypeRegistry
from ropeway.types.variant import Variant
from tests.support.inbox import Inbox
from tests.support.layouts import GO, LOOK, RANGE, drive_8_m, halves
from tests.support.until import until

from .conftest import Join

EVENT = "lifecycle_msgs/msg/TransitionEvent"
_HUMBLE_RANGE = TypeRegistry("humble", alone=True).text(RANGE)


def made(distro: str | None = None) -> TypeRegistry:
    """A registry of a distribution, with a service and an action that are made of a type that has changed."""
    registry = TypeRegistry(distro, alone=distro is not None)
    registry.add_text(LOOK, "sensor_msgs/Range seen\n---\nsensor_msgs/Range[] found\nuint8 last\n")
    registry.add_text(GO, "sensor_msgs/Range goal\n---\nsensor_msgs/Range end\n---\nsensor_msgs/Range way\n")
    return registry


HERE, HUMBLE = made(), made("humble")
OURS = HERE.codec(RANGE).encode({"range": 1.25, "variance": 0.5})
THEIRS = HUMBLE.codec(RANGE).encode({"range": 1.25})
WITHOUT = HERE.codec(RANGE).encode({"range": 1.25})


def sample(payload: bytes, type: str = RANGE) -> Sample:
    return Sample(payload, type, 1, new_origin(), SEQ_NONE)


def humble() -> Variant:
    registry = made()
    assert registry.others is not None
    variant = registry.others.variant("humble")
    assert isinstance(variant, Variant)
    return variant


def grow_old(graph: DdsGraph) -> None:
    """Write the gids of Humble, whatever others do."""
    assert graph._discovery is not None
    graph._discovery._tell_gid_bytes = lambda sizes: None
    graph.participant.follow_gid_bytes({24})


async def test_what_humble_writes_arrives(join: Join) -> None:
    """A message in Humble's layout is read in ours, raw as it goes on."""
    robot, graph = await join("robot"), await join("ours", registry=HERE)
    inbox = Inbox()
    await graph.create_subscription("/range", RANGE, None, inbox)
    publisher = await robot.create_publisher("/range", RANGE)
    await until(lambda: publisher.subscribers == 1)
    publisher.publish(sample(THEIRS))
    publisher.publish(sample(OURS))
    got = await inbox.wait(2)
    assert [one.payload for one in got] == [WITHOUT, OURS]


async def test_humble_gets_its_layout(join: Join) -> None:
    """What is written on a network that is said to be of Humble has Humble's layout, and its hash."""
    network = humble()
    robot, graph = await join("robot"), await join("ours", registry=network.ours, network=network)
    inbox = Inbox()
    await robot.create_subscription("/range", RANGE, None, inbox)
    publisher = await graph.create_publisher("/range", RANGE)
    await until(lambda: publisher.subscribers == 1)
    publisher.publish(sample(OURS))
    (got,) = await inbox.wait(1)
    assert got.payload == THEIRS
    assert (robot.distro, graph.distro) == ("", "humble")
    (endpoint,) = robot.topics()["/range"].publishers
    assert endpoint.type_hash == HUMBLE.hash(RANGE) != HERE.hash(RANGE)


async def test_a_network_of_old_nodes_is_recognised(join: Join, caplog: pytest.LogCaptureFixture) -> None:
    """Where all nodes write gids of 24 bytes, messages get Humble's layout without a word in the configuration."""
    robot = await join("robot")
    grow_old(robot)
    inbox = Inbox()
    await robot.create_subscription("/range", RANGE, None, inbox)
    graph = await join("ours", registry=HERE)
    with caplog.at_level(logging.INFO):
        publisher = await graph.create_publisher("/range", RANGE)
        await until(lambda: graph.participant.is_old and publisher.subscribers == 1)
    publisher.publish(sample(OURS))
    publisher.publish(sample(THEIRS))
    assert [one.payload for one in await inbox.wait(2)] == [THEIRS, THEIRS]
    assert "all nodes are of ROS 2 Humble or older" in caplog.text
    assert graph.distro == "humble"


async def test_one_old_node_among_new_ones_gets_its_layout(join: Join) -> None:
    """Each topic has the layout of those who read it, also where nodes of two distributions share a network."""
    old, new, graph = await join("old"), await join("new", registry=made()), await join("ours", registry=HERE)
    grow_old(old)
    inboxes = Inbox(), Inbox()
    await old.create_subscription("/old", RANGE, None, inboxes[0])
    await new.create_subscription("/new", RANGE, None, inboxes[1])
    for name in ("/old", "/new"):
        publisher = await graph.create_publisher(name, RANGE)
        assert graph._discovery is not None
        discovery = graph._discovery
        await until(lambda: publisher.subscribers == 1 and bool(discovery.signs("subscription", name)))  # noqa: B023
        publisher.publish(sample(OURS))
    assert [(await inbox.wait(1))[0].payload for inbox in inboxes] == [THEIRS, OURS]
    assert not graph.participant.is_old


async def test_given_definitions_win_over_what_is_recognised(join: Join, tmp_path: Path) -> None:
    """Where a network's own files are given, they count for old nodes, too."""
    (tmp_path / "my_msgs" / "msg").mkdir(parents=True)
    (tmp_path / "my_msgs" / "msg" / "Sonar.msg").write_text("sensor_msgs/Range[] seen\nuint8 old\n")
    ours, theirs = TypeRegistry(), TypeRegistry("humble", alone=True)
    ours.add_text("my_msgs/msg/Sonar", "sensor_msgs/Range[] seen\n")
    theirs.add_path(tmp_path)
    robot = await join("robot", registry=theirs)
    grow_old(robot)
    graph = await join("ours", registry=ours, network=Variant(ours, "humble", [tmp_path]))
    inbox, back = Inbox(), Inbox()
    await graph.create_subscription("/sonar", "my_msgs/msg/Sonar", None, inbox)
    await robot.create_subscription("/back", "my_msgs/msg/Sonar", None, back)
    publisher = await robot.create_publisher("/sonar", "my_msgs/msg/Sonar")
    returns = await graph.create_publisher("/back", "my_msgs/msg/Sonar")
    await until(lambda: publisher.subscribers == returns.subscribers == 1)
    await until(lambda: graph.participant.is_old)
    old, new = theirs.codec("my_msgs/msg/Sonar"), ours.codec("my_msgs/msg/Sonar")
    publisher.publish(sample(old.encode({"seen": [{"range": 1.5}, {"range": 2.5}], "old": 3}), "my_msgs/msg/Sonar"))
    (got,) = await inbox.wait(1)
    assert [one["range"] for one in new.decode(got.payload)["seen"]] == [1.5, 2.5]
    returns.publish(sample(got.payload, "my_msgs/msg/Sonar"))
    (came,) = await back.wait(1)
    assert came.payload == old.encode({"seen": [{"range": 1.5}, {"range": 2.5}]})


async def test_hashes_tell_layouts_of_one_length_apart(join: Join) -> None:
    """A message whose bytes fit two layouts is read in that of the hash which its publisher told."""
    lyrical = TypeRegistry("lyrical", alone=True)
    node, graph = await join("node", registry=lyrical), await join("ours", registry=HERE)
    inbox = Inbox()
    await graph.create_subscription("/event", EVENT, None, inbox)
    publisher = await node.create_publisher("/event", EVENT)
    await until(lambda: publisher.subscribers == 1)
    message = {"transition": {"id": 3, "label": "activate"}, "goal_state": {"id": 4, "label": "active"}}
    publisher.publish(sample(lyrical.codec(EVENT).encode({**message, "stamp": {"sec": 7, "nanosec": 9}}), EVENT))
    (got,) = await inbox.wait(1)
    read = HERE.codec(EVENT).decode(got.payload)
    assert read["transition"] == message["transition"]
    assert read["goal_state"] == message["goal_state"]
    assert read["timestamp"] == 0


@pytest.mark.parametrize("serves", ["there", "here"])
@pytest.mark.parametrize("told", ["given", "recognised"])
async def test_services_cross_between_distributions(join: Join, serves: str, told: str) -> None:
    """Requests and responses get the layout of the other side, whoever serves, also where the network is recognised."""
    network = humble()
    robot = await join("robot", registry=HUMBLE)
    if told == "given":
        graph = await join("ours", registry=network.ours, network=network)
    else:
        grow_old(robot)
        graph = await join("ours", registry=network.ours)
        await until(lambda: graph.participant.is_old)
    seen: list[float] = []
    server, client = (robot, graph) if serves == "there" else (graph, robot)
    mine, yours = (HUMBLE, HERE) if serves == "there" else (HERE, HUMBLE)

    async def look(request: Request) -> bytes:
        seen.append(mine.codec(f"{LOOK}_Request").decode(request.payload)["seen"]["range"])
        return mine.codec(f"{LOOK}_Response").encode({"found": [{"range": 2.5}, {"range": 3.5}], "last": 7})

    await server.create_service("/look", LOOK, look)
    caller = await client.create_client("/look", LOOK)
    answer = await caller.call(Request(yours.codec(f"{LOOK}_Request").encode({"seen": {"range": 1.5}})), 10)
    response = yours.codec(f"{LOOK}_Response").decode(answer)
    assert seen == [1.5]
    assert ([one["range"] for one in response["found"]], response["last"]) == ([2.5, 3.5], 7)


@pytest.mark.parametrize("serves", ["there", "here"])
async def test_actions_cross_between_distributions(join: Join, serves: str) -> None:
    """Goals, feedback and results get the layout of the other side, whoever carries the goal out."""
    network = humble()
    robot, graph = await join("robot", registry=HUMBLE), await join("ours", registry=network.ours, network=network)
    server, client = (robot, graph) if serves == "there" else (graph, robot)
    mine, yours = (HUMBLE, HERE) if serves == "there" else (HERE, HUMBLE)
    fed: list[float] = []

    await server.create_action_server("/go", GO, halves(mine, fed))
    caller = await client.create_action_client("/go", GO)
    await drive_8_m(caller, yours, fed, 10)
