"""Topics and services with Debian's rospy and the tools that come with it."""

from __future__ import annotations

import asyncio
import struct

import pytest

from ropeway.errors import CallFailed, ProviderLost
from ropeway.graph.calls import Request
from ropeway.qos import LATCHED
from ropeway.types import TypeRegistry
from tests.support.until import PATIENCE_S, until

from .conftest import Join
from .messages import STRING, Box, sample, text
from .network import HAS_ROSPY, HAS_TOOLS, RosMaster, rospy, running

pytestmark = pytest.mark.skipif(not HAS_ROSPY, reason="needs rospy, which .ci/run installs on Debian")

PUBLISH = """
import rospy, sys
from std_msgs.msg import String
rospy.init_node("talker")
pub = rospy.Publisher("/chatter", String, queue_size=100, latch={latch})
print("ready")
for line in sys.stdin:
    pub.publish(line.strip())
"""

ECHO = """
import rospy
from std_msgs.msg import String
rospy.init_node("listener")
rospy.Subscriber("/chatter", String, lambda m: print("heard", m.data))
print("ready")
rospy.spin()
"""

CAMERA = """
import rospy
from sensor_msgs.msg import CameraInfo
rospy.init_node("camera")
def show(m):
    print("seen", m.header.seq, m.header.stamp, m.header.frame_id, m.height, list(m.D), m.K[0], flush=True)
    m.D, m.height = [9.0], 7
    pub.publish(m)
pub = rospy.Publisher("/back", CameraInfo, queue_size=10, latch=True)
rospy.Subscriber("/camera", CameraInfo, show)
print("ready")
rospy.spin()
"""

SERVE = """
import rospy
from std_srvs.srv import SetBool, SetBoolResponse
rospy.init_node("server")
def answer(request):
    if request.data:
        return SetBoolResponse(True, "yes")
    raise ValueError("no no no")
rospy.Service("/switch", SetBool, answer)
print("ready")
rospy.spin()
"""

CALL = """
import rospy
from std_srvs.srv import SetBool
rospy.init_node("caller")
rospy.wait_for_service("/switch")
for persistent in (False, True):
    switch = rospy.ServiceProxy("/switch", SetBool, persistent=persistent)
    for value in (True, True, False):
        try:
            answer = switch(value)
            print("answer", persistent, answer.success, answer.message)
        except rospy.ServiceException as error:
            print("failed", persistent, error)
print("done")
"""

THING = """
import rospy, genpy.dynamic
text = '''Header header
Part[] parts
uint8 KIND=3
================================================================================
MSG: std_msgs/Header
uint32 seq
time stamp
string frame_id
================================================================================
MSG: my_robot/Part
string name
time made
'''
types = genpy.dynamic.generate_dynamic("my_robot/Thing", text)
Thing, Part = types["my_robot/Thing"], types["my_robot/Part"]
rospy.init_node("inventor")
pub = rospy.Publisher("/things", Thing, queue_size=10, latch=True)
thing = Thing(parts=[Part("wheel", rospy.Time(7, 8))])
thing.header.frame_id = "shop"
pub.publish(thing)
print("ready")
rospy.spin()
"""


async def test_subscription(master: RosMaster, join: Join) -> None:
    """What rospy publishes arrives in order."""
    graph, box = await join(), Box()
    async with rospy(master, PUBLISH.format(latch=False)) as talker:
        await talker.wait_for("ready")
        subscription = await graph.create_subscription("/chatter", STRING, None, box)
        await until(lambda: subscription._reader.links)
        for number in range(100):
            talker.tell(f"message {number}")
        await until(lambda: len(box.samples) == 100)
    assert box.texts == [f"message {number}" for number in range(100)]
    numbers = [sample.seq for sample in box.samples]
    assert numbers == sorted(set(numbers))
    assert len({sample.origin for sample in box.samples}) == 1


async def test_latched_subscription(master: RosMaster, join: Join) -> None:
    """What rospy has latched arrives, and the subscription knows that it is latched."""
    graph, box = await join(), Box()
    async with rospy(master, PUBLISH.format(latch=True)) as talker:
        talker.tell("kept")
        await talker.wait_for("ready")
        subscription = await graph.create_subscription("/chatter", STRING, None, box)
        await until(lambda: box.samples)
        assert box.texts == ["kept"]
        assert subscription.qos.transient_local
        await until(lambda: graph.topics()["/chatter"].publishers[0].qos.transient_local)


async def test_publisher(master: RosMaster, join: Join) -> None:
    """What is published arrives at rospy, whatever its letters."""
    graph = await join()
    publisher = await graph.create_publisher("/chatter", STRING)
    async with rospy(master, ECHO) as listener:
        await until(lambda: publisher.subscribers == 1)
        publisher.publish(sample(text("grüße")))
        await listener.wait_for("heard grüße")
    await until(lambda: publisher.subscribers == 0)


async def test_latched_publisher(master: RosMaster, join: Join) -> None:
    """What is published latched arrives at a rospy node that comes later."""
    graph = await join()
    publisher = await graph.create_publisher("/chatter", STRING, LATCHED)
    publisher.publish(sample(text("map")))
    async with rospy(master, ECHO) as listener:
        await listener.wait_for("heard map")


async def test_types_that_differ(master: RosMaster, join: Join) -> None:
    """A CameraInfo, whose header and field names differ in ROS 1, arrives there and comes back."""
    graph, box = await join(), Box()
    type = "sensor_msgs/msg/CameraInfo"
    codec = graph.registry.codec(type)
    publisher = await graph.create_publisher("/camera", type)
    await graph.create_subscription("/back", type, None, box)
    stamp = {"sec": 5, "nanosec": 6}
    sent = {"header": {"stamp": stamp, "frame_id": "lens"}, "height": 480, "d": [0.5, 0.25], "k": [2.0] * 9}
    async with rospy(master, CAMERA) as camera:
        await until(lambda: publisher.subscribers == 1)
        publisher.publish(sample(codec.encode(sent), type))
        assert "5000000006 lens 480 [0.5, 0.25] 2.0" in await camera.wait_for("seen")
        await until(lambda: box.samples)
    got = codec.decode(box.payloads[0])
    assert (got["header"], got["height"], list(got["d"])) == (sent["header"], 7, [9.0])


async def test_learns_types(master: RosMaster, join: Join) -> None:
    """A type that nobody here knows is learned from its publisher, and known to the registry then."""
    registry = TypeRegistry()
    graph, box = await join(registry=registry), Box()
    async with rospy(master, THING) as inventor:
        await inventor.wait_for("ready")
        await until(lambda: registry.has("my_robot/msg/Thing"))
        await graph.create_subscription("/things", "my_robot/msg/Thing", None, box)
        await until(lambda: box.samples)
    got = registry.codec("my_robot/msg/Thing").decode(box.payloads[0])
    assert got["header"]["frame_id"] == "shop"
    assert got["parts"] == [{"name": "wheel", "made": {"sec": 7, "nanosec": 8}}]


async def test_learns_while_reading(master: RosMaster, join: Join) -> None:
    """A subscription may ask for a type before anybody can tell what it is."""
    registry = TypeRegistry()
    graph, box = await join(registry=registry), Box()
    await graph.create_subscription("/things", "my_robot/msg/Thing", None, box)
    async with rospy(master, THING):
        await until(lambda: box.samples)
    assert registry.codec("my_robot/msg/Thing").decode(box.payloads[0])["header"]["frame_id"] == "shop"


async def test_client(master: RosMaster, join: Join) -> None:
    """A service of rospy answers, and says why it does not."""
    graph = await join()
    async with rospy(master, SERVE) as server:
        await server.wait_for("ready")
        client = await graph.create_client("/switch", "std_srvs/srv/SetBool")
        assert await client.wait_available(PATIENCE_S)
        for _ in range(3):
            assert await client.call(Request(b"\0\1\0\0\1")) == b"\0\1\0\0\1\0\0\0\4\0\0\0yes\0"
        with pytest.raises(CallFailed, match="no no no"):
            await client.call(Request(b"\0\1\0\0\0"))
        await until(lambda: graph.services()["/switch"].type == "std_srvs/srv/SetBool")


async def test_lost_provider(master: RosMaster, join: Join) -> None:
    """A provider that is killed in mid-call fails the call at once."""
    graph = await join()
    slow = SERVE.replace("    if request.data:", "    print('asked'); rospy.sleep(60)\n    if request.data:")
    async with rospy(master, slow) as server:
        await server.wait_for("ready")
        client = await graph.create_client("/switch", "std_srvs/srv/SetBool")

        async def kill() -> None:
            await server.wait_for("asked")
            await server.kill()

        killing = asyncio.create_task(kill())
        with pytest.raises(ProviderLost):
            await client.call(Request(b"\0\1\0\0\1"), 50)
        await killing


async def test_service(master: RosMaster, join: Join) -> None:
    """A service is called by rospy, over one connection or many, and its failures are told."""
    graph = await join()

    async def switch(request: Request) -> bytes:
        if not request.payload[4]:
            raise CallFailed("/switch", "stays on")
        return b"\0\1\0\0\1\0\0\0" + struct.pack("<I", 3) + b"on\0"

    await graph.create_service("/switch", "std_srvs/srv/SetBool", switch)
    async with rospy(master, CALL) as caller:
        await caller.wait_for("done")
    assert [line for line in caller.lines if "answer" in line] == [
        f"answer {persistent} True on" for persistent in (False, False, True, True)
    ]
    assert len([line for line in caller.lines if "failed" in line and "stays on" in line]) == 2


@pytest.mark.skipif(not HAS_TOOLS, reason="needs rostopic, rosservice and rosnode, which .ci/run installs on Debian")
async def test_tools(master: RosMaster, join: Join) -> None:
    """rostopic, rosservice and rosnode see the node and all that it has."""
    graph = await join()

    async def switch(request: Request) -> bytes:
        return b"\0\1\0\0\1\0\0\0" + struct.pack("<I", 3) + b"on\0"

    publisher = await graph.create_publisher("/chatter", STRING, LATCHED)
    publisher.publish(sample(text("hello")))
    await graph.create_service("/switch", "std_srvs/srv/SetBool", switch)
    for command, expected in (
        (("rostopic", "echo", "-n", "1", "/chatter"), 'data: "hello"'),
        (("rostopic", "info", "/chatter"), "* /near (http://127.0.0.1:"),
        (("rosservice", "type", "/switch"), "std_srvs/SetBool"),
        (("rosservice", "call", "/switch", "true"), 'message: "on"'),
        (("rosnode", "ping", "-c", "1", "/near"), "xmlrpc reply from http://127.0.0.1"),
        (("rosnode", "info", "/near"), "* /chatter [std_msgs/String]"),
    ):
        async with running(master, "/usr/bin/python3", f"/usr/bin/{command[0]}", *command[1:]) as tool:
            await tool.wait_for(expected)


async def test_wrong_sum(master: RosMaster, join: Join) -> None:
    """A rospy node that wants a topic with another type is told so, and disturbs nobody."""
    graph = await join()
    other, box = await join("far"), Box()
    publisher = await graph.create_publisher("/chatter", STRING)
    await other.create_subscription("/chatter", STRING, None, box)
    wrong = ECHO.replace("String", "Int32")
    async with rospy(master, wrong) as listener:
        await listener.wait_for("ready")
        await until(lambda: publisher.subscribers == 1)
        publisher.publish(sample(text("hello")))
        await until(lambda: box.samples)
        await until(lambda: graph.topics()["/chatter"].subscriptions)
        assert publisher.subscribers == 1


async def test_publisher_is_killed(master: RosMaster, join: Join) -> None:
    """A publisher that is killed and comes back under its name is read again."""
    graph, box = await join(), Box()
    subscription = await graph.create_subscription("/chatter", STRING, None, box)
    for word in ("first", "second"):
        async with rospy(master, PUBLISH.format(latch=True)) as talker:
            talker.tell(word)
            await until(lambda word=word: word in box.texts)
            await talker.kill()
        await until(lambda: not subscription._reader.links)
    assert box.texts == ["first", "second"]


async def test_parameters(master: RosMaster, join: Join) -> None:
    """Parameters are set, read, listed and deleted, alone and as namespaces."""
    graph = await join()
    await graph.set_param("/robot", {"name": "r2", "wheels": [1, 2], "mass": 2.5, "ready": True})
    assert await graph.get_param("/robot/wheels") == [1, 2]
    assert await graph.get_param("/robot") == {"name": "r2", "wheels": [1, 2], "mass": 2.5, "ready": True}
    assert {"/robot/name", "/robot/mass"} <= set(await graph.list_params())
    await graph.delete_param("/robot/name")
    for ask in (graph.get_param, graph.delete_param):
        with pytest.raises(KeyError):
            await ask("/robot/name")
    with pytest.raises(ValueError, match="XML-RPC"):
        await graph.set_param("/robot/big", 2**40)
