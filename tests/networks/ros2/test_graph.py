"""The ``ros2`` graph beyond the contract, among itself and among genuine nodes."""

from __future__ import annotations

import asyncio
import os
import struct
import sys
import time

import pytest

from ropeway.errors import CallFailed, GraphUnavailable, InvalidName, UnknownType
from ropeway.graph.base import Sample, TopicInfo, Undelivered
from ropeway.graph.calls import ActionHandlers, Goal, GoalStatus, Outcome, Request, ServerGoal
from ropeway.networks.ros2 import Ros2Graph
from ropeway.networks.ros2.profiles import from_rclpy, reader_profile, writer_profile
from ropeway.qos import LATCHED, SENSOR_DATA, QoS
from ropeway.types import TypeRegistry
from tests.support.actions import FIBONACCI, order, sequence
from tests.support.inbox import Inbox
from tests.support.messages import STRING, joined, sample, text
from tests.support.services import ADD, add, addends, total
from tests.support.until import PATIENCE_S, until

from .conftest import World

pytestmark = [pytest.mark.ros, pytest.mark.timeout(120)]

EMPTY = TopicInfo("", ())
TRIGGER = "std_srvs/srv/Trigger"
CALLS = "ros2_calls_peer.py"


def texts(inbox: Inbox) -> list[str]:
    """The strings that arrived."""
    codec = TypeRegistry().codec(STRING)
    return [codec.decode(payload)["data"] for payload in inbox.payloads]


async def test_hears_a_genuine_publisher(world: World) -> None:
    """What a node publishes arrives with its time stamp, and the node, its gid and its profile are seen."""
    await world.node("pub", "/chatter", STRING, "--node", "talker", "--hz", "20")
    graph = await world.graph()
    inbox = Inbox()
    await graph.create_subscription("/chatter", STRING, None, inbox)
    await inbox.wait(10, 20)
    heard = texts(inbox)
    first = int(heard[0].split()[1])
    assert heard[:10] == [f"hello {i}" for i in range(first, first + 10)]
    await until(lambda: "/talker" in graph.nodes() and graph.settled)
    (end,) = graph.topics()["/chatter"].publishers
    assert (end.node, end.type, end.qos.reliable, end.local) == ("/talker", STRING, True, False)
    inbox.samples.clear()
    got = await inbox.wait(3)
    assert {s.origin for s in got} == {end.gid}
    assert all(0 <= s.stamp_ns - s.seq < 10**9 for s in got)


async def test_is_heard_by_a_genuine_reader(world: World) -> None:
    """What we publish arrives at a node, in order and without loss."""
    listener = await world.node("sub", "/cmd", STRING, "--depth", "100")
    graph = await world.graph()
    publisher = await graph.create_publisher("/cmd", STRING, QoS(depth=100))
    await until(lambda: publisher.subscribers == 1)
    while not listener.heard:
        publisher.publish(sample("are you there"))
        await asyncio.sleep(0.05)
    await asyncio.sleep(0.2)
    before = len(listener.heard)
    for i in range(50):
        publisher.publish(sample(str(i)))
    await until(lambda: len(listener.heard) >= before + 50)
    assert listener.heard[before:] == [str(i) for i in range(50)]


async def test_looking_at_readers_tells_nobody(world: World) -> None:
    """Who asks how many read a topic changes nothing: a change is told when the graph has seen it."""
    publisher = await (await world.graph()).create_publisher("/cmd", STRING, QoS())
    told: list[int] = []
    publisher.on_demand(told.append)
    await world.node("sub", "/cmd", STRING)
    while not publisher.subscribers:
        before = list(told)
        assert publisher.subscribers in (0, 1)
        assert told == before
        await asyncio.sleep(0.01)
    await until(lambda: told == [0, 1])


async def test_latched_by_several(world: World) -> None:
    """What several nodes latched arrives at a late reader, each message once."""
    for name in ("one", "two"):
        await world.node(
            "pub", "/map", STRING, "--latched", "--count", "1", "--depth", "1", "--node", name, "--text", name
        )
    graph = await world.graph()
    await until(lambda: len(graph.topics().get("/map", EMPTY).publishers) == 2)
    inbox = Inbox()
    await graph.create_subscription("/map", STRING, None, inbox)
    await inbox.wait(2)
    await asyncio.sleep(0.3)
    assert sorted(texts(inbox)) == ["one 0", "two 0"]


async def test_calls_a_genuine_server(world: World) -> None:
    """A node's service is found, called many times at once, and its leaving is told."""
    server = await world.node("serve", "/sum", program=CALLS)
    graph = await world.graph()
    client = await graph.create_client("/sum", ADD)
    assert await client.wait_available(PATIENCE_S)
    answers = await asyncio.gather(*(client.call(Request(addends(i, 1)), 30) for i in range(100)))
    assert answers == [total(i + 1) for i in range(100)]
    await until(lambda: [s.node for s in graph.services()["/sum"].servers] != [])
    assert graph.services()["/sum"].type == ADD
    await server.end()


async def test_serves_a_genuine_client(world: World) -> None:
    """A node's calls are answered."""
    graph = await world.graph()
    await graph.create_service("/sum", ADD, add)
    caller = await world.node("call", "/sum", "--count", "50", program=CALLS)
    await until(lambda: any("right" in said for said in caller.said))
    assert caller.said[-1]["right"] == 50


async def test_genuine_action_server(world: World) -> None:
    """A node's action is used: accepted, fed back, ended with its result."""
    await world.node("act", "/fibonacci", program=CALLS)
    graph = await world.graph()
    client = await graph.create_action_client("/fibonacci", FIBONACCI)
    assert await client.wait_available(PATIENCE_S)
    feedback: list[bytes] = []
    goal = await client.send_goal(Goal(order(6)), on_feedback=feedback.append)
    outcome = await goal.result(PATIENCE_S)
    assert outcome.status is GoalStatus.SUCCEEDED
    assert outcome.payload == sequence(0, 1, 1, 2, 3, 5)
    assert feedback
    await until(lambda: graph.actions().get("/fibonacci") is not None)
    assert graph.actions()["/fibonacci"].type == FIBONACCI


async def test_genuine_action_client(world: World) -> None:
    """A node uses an action of ours."""

    async def count(goal: ServerGoal) -> Outcome:
        goal.feedback(sequence(0))
        return Outcome(GoalStatus.SUCCEEDED, sequence(0, 1, 1, 2, 3, 5))

    graph = await world.graph()
    await graph.create_action_server("/fibonacci", FIBONACCI, ActionHandlers(count))
    user = await world.node("goal", "/fibonacci", program=CALLS)
    await until(lambda: any("status" in said for said in user.said))
    assert [said["status"] for said in user.said if "status" in said] == [int(GoalStatus.SUCCEEDED)]


async def test_same_gateway(world: World) -> None:
    """Two processes of one gateway do not count as each other's readers, and others know the gateway."""
    first = await world.graph("first", gateway_id="ab;12")
    second = await world.graph("second", gateway_id="ab;12")
    other = await world.graph("other")
    publisher = await first.create_publisher("/t", STRING)
    near, far = Inbox(), Inbox()
    await second.create_subscription("/t", STRING, QoS(), near)
    await until(lambda: "/t" in other.topics() and len(other.topics()["/t"].subscriptions) == 1)
    await until(lambda: publisher.subscribers == 0)
    await other.create_subscription("/t", STRING, QoS(), far)
    await until(lambda: publisher.subscribers == 1)
    await until(lambda: [e.gateway for e in other.topics()["/t"].publishers] == ["ab;12"])
    await until(lambda: [e.gateway for e in second.topics()["/t"].publishers] == ["ab;12"])
    publisher.publish(sample("hello"))
    await far.wait(1)
    await asyncio.sleep(0.1)
    assert near.samples == []


async def test_hears_others_beside_itself(world: World) -> None:
    """A topic that we publish, too, brings the messages of others only."""
    near, far = await world.graph("near"), await world.graph("far")
    ours, theirs = await near.create_publisher("/t", STRING), await far.create_publisher("/t", STRING)
    inbox = Inbox()
    subscription = await near.create_subscription("/t", STRING, QoS(depth=100), inbox)
    await far.create_subscription("/t", STRING, QoS(depth=100), lambda _: None)
    await until(lambda: ours.subscribers == 1)
    await joined(theirs, read_by=[subscription])
    for number in range(5):
        ours.publish(sample(f"ours {number}"))
        theirs.publish(sample(f"theirs {number}"))
    await inbox.wait(5)
    await asyncio.sleep(0.1)
    assert texts(inbox) == [f"theirs {number}" for number in range(5)]


async def test_sensor_data(world: World) -> None:
    """Best-effort publishers and readers match."""
    near, far = await world.graph("near"), await world.graph("far")
    publisher = await near.create_publisher("/scan", STRING, SENSOR_DATA)
    inbox = Inbox()
    await far.create_subscription("/scan", STRING, SENSOR_DATA, inbox)
    await until(lambda: publisher.subscribers == 1)
    while not inbox.samples:
        publisher.publish(sample("reading"))
        await asyncio.sleep(0.02)


async def test_unknown_packages(world: World) -> None:
    """A type whose package is not installed is refused with what to install, one its package does not have as such."""
    graph = await world.graph()
    with pytest.raises(UnknownType, match=r"install ros-.*-no-such-pkg"):
        await graph.create_publisher("/t", "no_such_pkg/msg/Thing")
    with pytest.raises(UnknownType, match="has no msg/Thing"):
        await graph.create_subscription("/t", "std_msgs/msg/Thing", None, lambda _: None)
    with pytest.raises(UnknownType, match="no_such_pkg"):
        await graph.create_client("/t", "no_such_pkg/srv/Thing")


async def test_failures_have_words(world: World) -> None:
    """A handler that fails is answered with the default response, with its words where the type has room for them."""

    async def refuse(request: Request) -> bytes:
        raise CallFailed("/stop", "the brake is broken")

    near, far = await world.graph("near"), await world.graph("far")
    await near.create_service("/stop", TRIGGER, refuse)
    client = await far.create_client("/stop", TRIGGER)
    response = await client.call(Request(b"\0\1\0\0\0"), 10)
    assert TypeRegistry().codec(f"{TRIGGER}_Response").decode(response) == {
        "success": False,
        "message": "the brake is broken",
    }


async def test_unreadable_payloads(world: World) -> None:
    """A request that is none fails its call, a response that is none is answered with the default one."""

    async def nonsense(request: Request) -> bytes:
        return b"\0\1\0\0"

    near, far = await world.graph("near"), await world.graph("far")
    await near.create_service("/sum", ADD, nonsense)
    client = await far.create_client("/sum", ADD)
    with pytest.raises(CallFailed, match="cannot be sent"):
        await client.call(Request(b"\0\1\0\0\1"), 10)
    assert await client.call(Request(addends(1, 2)), 10) == total(0)
    assert near.drops["/sum", Undelivered.WRITE] == 1


async def test_drops_are_counted(world: World) -> None:
    """What is published after the end, or is no CDR, is counted."""
    graph = await world.graph()
    publisher = await graph.create_publisher("/t", STRING)
    publisher.publish(Sample(b"\0\1", STRING, 0, bytes(16), 0))
    assert graph.drops["/t", Undelivered.ENCODE] == 1
    await publisher.close()
    publisher.publish(sample("late"))
    assert graph.drops["/t", Undelivered.CLOSED] == 1


async def test_publish_and_close(world: World) -> None:
    """What was published right before the end arrives."""
    near, far = await world.graph("near"), await world.graph("far")
    inbox = Inbox()
    subscription = await far.create_subscription("/t", STRING, QoS(depth=100), inbox)
    publisher = await near.create_publisher("/t", STRING, QoS(depth=100))
    await joined(publisher, read_by=[subscription])
    publisher.publish(sample("last"))
    await publisher.close()
    await inbox.wait(1)


async def test_big_endian(world: World) -> None:
    """A message of a big-endian machine arrives little-endian."""
    near, far = await world.graph("near"), await world.graph("far")
    inbox = Inbox()
    subscription = await far.create_subscription("/t", STRING, QoS(), inbox)
    publisher = await near.create_publisher("/t", STRING)
    await joined(publisher, read_by=[subscription])
    publisher.publish(Sample(b"\0\0\0\0" + struct.pack(">I", 4) + b"big\0", STRING, 0, bytes(16), 0))
    await inbox.wait(1)
    assert inbox.payloads == [text("big")]


async def test_messages_of_another_distribution(world: World) -> None:
    """A message in Humble's layout goes out in that of the ROS 2 that is sourced, as readers there need it."""
    near, far = await world.graph("near"), await world.graph("far")
    name = "sensor_msgs/msg/Range"
    inbox = Inbox()
    subscription = await far.create_subscription("/range", name, QoS(), inbox)
    publisher = await near.create_publisher("/range", name)
    await joined(publisher, read_by=[subscription])
    raw = TypeRegistry("humble", alone=True).codec(name).encode({"range": 1.25})
    publisher.publish(Sample(raw, name, 0, bytes(16), 0))
    await inbox.wait(1)
    assert inbox.payloads == [near.registry.codec(name).encode({"range": 1.25})]


async def test_behind(world: World) -> None:
    """A loop that is busy for a while gets the newest messages afterwards, and goes on."""
    near, far = await world.graph("near"), await world.graph("far")
    inbox = Inbox()
    subscription = await far.create_subscription("/t", STRING, QoS(depth=20), inbox)
    publisher = await near.create_publisher("/t", STRING, QoS(depth=20))
    await joined(publisher, read_by=[subscription])
    for number in range(200):
        publisher.publish(sample(str(number)))
    time.sleep(0.3)  # noqa: ASYNC251 - the loop is busy
    await until(lambda: inbox.samples and texts(inbox)[-1] == "199")
    publisher.publish(sample("more"))
    await until(lambda: texts(inbox)[-1] == "more")


async def test_reopened(world: World) -> None:
    """A graph that was closed can be opened again."""
    graph, far = await world.graph(), await world.graph("far")
    await graph.close()
    await graph.close()
    await graph.open()
    await graph.open()
    inbox = Inbox()
    subscription = await graph.create_subscription("/t", STRING, QoS(), inbox)
    publisher = await far.create_publisher("/t", STRING)
    await joined(publisher, read_by=[subscription])
    publisher.publish(sample("again"))
    await inbox.wait(1)


async def test_profiles(isolation: int) -> None:
    """A profile survives the way to rclpy and back; readers keep a bounded number."""
    for qos in (QoS(depth=7, deadline_s=0.5, lifespan_s=2.5), LATCHED, SENSOR_DATA, QoS(history="keep_all", depth=1)):
        back = from_rclpy(writer_profile(qos))
        assert (back.reliability, back.durability, back.history) == (qos.reliability, qos.durability, qos.history)
        assert (back.deadline_s, back.lifespan_s) == (qos.deadline_s, qos.lifespan_s)
    assert from_rclpy(reader_profile(QoS(history="keep_all"))).history == "keep_last"
    assert from_rclpy(reader_profile(LATCHED)).depth >= 100


def test_bad_names() -> None:
    """A domain that does not exist and a node name with a slash are refused."""
    with pytest.raises(GraphUnavailable, match="from 0 to 232"):
        Ros2Graph(233)
    with pytest.raises(InvalidName, match="slash"):
        Ros2Graph(0, name="a/b")


async def test_no_middleware(isolation: int) -> None:
    """A middleware that is not installed is said to be missing."""
    program = (
        "import asyncio\n"
        "from ropeway.errors import GraphUnavailable\n"
        "from ropeway.networks.ros2 import Ros2Graph\n"
        "async def main():\n"
        "    try:\n"
        f"        await Ros2Graph({isolation}).open()\n"
        "    except GraphUnavailable as error:\n"
        "        print('said:', error)\n"
        "asyncio.run(main())\n"
    )
    env = {**os.environ, "RMW_IMPLEMENTATION": "rmw_nothing_cpp"}
    process = await asyncio.create_subprocess_exec(
        sys.executable, "-c", program, stdout=asyncio.subprocess.PIPE, stderr=asyncio.subprocess.DEVNULL, env=env
    )
    out, _ = await process.communicate()
    assert b"said: ros2:" in out
    assert b"rmw_nothing_cpp" in out
