"""The server as a whole against rosbridge: what must be the same, and what is better on purpose.

What concerns one operation alone stands in the tests of its module; malformed input in ``test_bad_input``.
"""

from __future__ import annotations

import json
import math
import struct
import time
from typing import Any

import pytest

from ropeway.errors import AccessDenied
from ropeway.graph.base import SEQ_NONE, Sample
from ropeway.graph.calls import ActionHandlers, Request
from ropeway.listener.authorization import Access
from ropeway.networks.memory.graph import MemoryPublisher
from ropeway.qos import LATCHED, SENSOR_DATA, QoS
from tests.networks.rosbridge.server.test_session import CHATTER, heard, listen, said
from tests.support.actions import FIBONACCI, count
from tests.support.clock import Stopwatch
from tests.support.inbox import Inbox
from tests.support.messages import STRING, sample, text
from tests.support.place import Place
from tests.support.services import ADD, add
from tests.support.until import until
from tests.support.websocket import BINARY, Client

pytestmark = pytest.mark.jumping

IMU, FLOATS = "sensor_msgs/msg/Imu", "std_msgs/msg/Float64MultiArray"


async def publisher(
    place: Place, topic: str = "/chatter", qos: QoS | None = None, type: str = STRING
) -> MemoryPublisher:
    return await place.robot.create_publisher(topic, type, qos)


# ── notices ────────────────────────────────────────────────────────────────────────────────────────────────────────

NOTICES: dict[str, tuple[str, str]] = {
    "no op": ('{"topic":"/x"}', "operation: Received a message without an op.  All messages require 'op' field"),
    "unknown op": ('{"op":"fly","id":"i"}', "operation: Unknown operation: fly.  Allowed operations: ['advertise',"),
    "ros 1": ('{"op":"set_level","level":"info"}', "operation: Unknown operation: set_level.  Allowed operations: "),
    "no topic": ('{"op":"subscribe"}', "operation: subscribe: Expected a topic field but none was found."),
    "no type": ('{"op":"advertise","topic":"/x"}', "operation: advertise: Expected a type field but none was found."),
    "wrong type": (
        '{"op":"advertise","topic":5,"type":"std_msgs/String"}',
        "operation: advertise: Expected field topic to be one of (<class 'str'>,). Invalid value: 5",
    ),
    "no service": ('{"op":"call_service"}', "operation: call_service: Expected a service field but none was found."),
    "no result": (
        '{"op":"service_response","service":"/x","id":"i","values":{}}',
        "operation: service_response: Expected a result field but none was found.",
    ),
    "conflict": (
        '{"op":"advertise","topic":"/robot","type":"std_msgs/Int32"}',
        "advertise: Tried to register topic /robot with type std_msgs/msg/Int32"
        " but it is already established with type std_msgs/msg/String",
    ),
    "no type to infer": (
        '{"op":"publish","topic":"/nobody","msg":{}}',
        "publish: Cannot infer topic type for topic /nobody as it is not yet advertised",
    ),
    "no service of ours": (
        '{"op":"unadvertise_service","service":"/x"}',
        "unadvertise_service: Service /x has not been advertised via rosbridge, can't unadvertise.",
    ),
    "no action of ours": (
        '{"op":"unadvertise_action","action":"/x"}',
        "unadvertise_action: Action /x has not been advertised via rosbridge, can't unadvertise.",
    ),
    "no id": (
        '{"op":"fragment","data":"","num":0,"total":1}',
        "operation: fragment: received invalid fragment! No message ID found.",
    ),
    "no fragment": ('{"op":"fragment","id":"i"}', "operation: fragment: received invalid fragment!"),
    "qos": (
        '{"op":"advertise","topic":"/x","type":"std_msgs/String","qos":{"reliability":"fast"}}',
        "advertise: 'fast' is not a valid reliability. Valid options are: reliable, best_effort, best_available",
    ),
}


@pytest.mark.parametrize("name", NOTICES)
async def test_notices(place: Place, name: str) -> None:
    """A client that wants to know is told what it did wrong, in rosbridge's words, with its id; nobody else is."""
    request, words = NOTICES[name]
    await publisher(place, "/robot")
    curious, other = await place.client(path="/?status=1"), await place.client()
    for client in (curious, other):
        client.send(request)
    got = await curious.json()
    assert got.pop("id", None) == json.loads(request).get("id")
    assert list(got) == ["op", "level", "msg"]
    assert (got["op"], got["level"]) == ("status", "error")
    assert got["msg"].startswith(words)
    await curious.nothing()
    await other.nothing()


@pytest.mark.parametrize(("query", "count"), [("?status=1", 1), ("?token=x&status=true", 1), ("?status=0", 0), ("", 0)])
async def test_asking_for_notices(place: Place, query: str, count: int) -> None:
    """Notices are asked for in the URL, since some libraries stumble over an operation that rosbridge has not."""
    client = await place.client(path=f"/{query}")
    client.send("no json")
    if count:
        assert (await client.json())["op"] == "status"
    await client.nothing()


# ── side effects that rosbridge has ────────────────────────────────────────────────────────────────────────────────


async def test_no_side_effects(place: Place) -> None:
    """What one operation asks for changes nothing of the rest of the connection."""
    await place.robot.create_service("/add", ADD, add)
    robot = await publisher(place)
    client = await place.client()
    client.send(listen())
    client.send({"op": "call_service", "service": "/add", "fragment_size": 40, "message_intervall": 10, "png": 1})
    client.send(listen("/other", fragment_size=40, message_intervall=1000.0))
    client.send({"op": "unadvertise", "topic": "/x", "fragment_size": None, "message_intervall": "x", "png": {}})
    pieces = [await client.json() for _ in range(2)]
    assert [(p["op"], p["num"], p["total"]) for p in pieces] == [("fragment", 0, 2), ("fragment", 1, 2)]
    await client.done()
    for number in range(20):
        robot.publish(sample("x" * 100 + str(number)))
    got = [await client.json(1) for _ in range(20)]
    assert got == [heard("x" * 100 + str(number)) for number in range(20)]
    assert place.complaints == {}


async def test_parameters_are_per_client(place: Place) -> None:
    """What one client asks of a topic changes nothing for another client of the same topic."""
    robot = await publisher(place, qos=QoS(depth=100))
    odd, plain = await place.client(), await place.client()
    odd.send(listen(throttle_rate=10_000, queue_length=1, fragment_size=50, compression="png"))
    plain.send(listen())
    for client in (odd, plain):
        await client.done()
    for number in range(10):
        robot.publish(sample(str(number)))
    assert [await plain.json() for _ in range(10)] == [heard(str(number)) for number in range(10)]
    assert (await odd.json())["op"] == "fragment"


# ── names that appear later ────────────────────────────────────────────────────────────────────────────────────────


async def test_topic_that_appears_later(place: Place) -> None:
    """A subscription without a type to a topic that is not there begins when the topic appears."""
    client, other = await place.client(), await place.client()
    client.send(listen("later", type=None, id="a"))
    client.send(listen("/later", type=None, id="b"))
    other.send(listen("/later", type=None, id="a"))
    other.send({"op": "unsubscribe", "topic": "/later", "id": "a"})
    for one in (client, other):
        await one.done()
    robot = await publisher(place, "/later")
    await until(lambda: robot.subscribers)
    robot.publish(sample("now"))
    assert sorted([(await client.json())["topic"], (await client.json())["topic"]]) == ["/later", "later"]
    await client.nothing()
    await other.nothing()
    assert place.complaints == {}


async def test_topic_of_another_client_that_appears_later(place: Place) -> None:
    """The same holds for topics of other clients, with what they latched."""
    reader, talker = await place.client(), await place.client()
    reader.send(listen(type=None))
    await reader.done()
    talker.send({**CHATTER, "latch": True})
    talker.send(said("kept"))
    assert await reader.json() == heard("kept")


# ── quality of service ─────────────────────────────────────────────────────────────────────────────────────────────


async def test_follows_publishers(place: Place) -> None:
    """A subscription fits itself anew whenever publishers come and go, so that what they latched arrives."""
    client = await place.client()
    client.send(listen())
    await client.done()
    for number, qos in enumerate((SENSOR_DATA, LATCHED, QoS(), SENSOR_DATA, LATCHED)):
        robot = await publisher(place, qos=qos)
        if qos.transient_local:
            robot.publish(sample(f"{number} kept"))
            assert await client.json() == heard(f"{number} kept")
        await until(lambda r=robot: r.subscribers)
        robot.publish(sample(str(number)))
        assert await client.json() == heard(str(number))
        await robot.close()
    await client.nothing()


async def test_all_that_is_latched(place: Place) -> None:
    """A late reader has everything that all publishers latched, once; who asks again has it again."""
    wanted = []
    for number in range(3):
        robot = await publisher(place, "/static", QoS(durability="transient_local", depth=2))
        for part in "ab":
            robot.publish(sample(f"{number}{part}"))
            wanted.append(heard(f"{number}{part}", "/static"))
    talker = await place.client()
    talker.send({"op": "advertise", "topic": "/static", "type": "std_msgs/String", "latch": True})
    talker.send(said("client", "/static"))
    await talker.done()
    wanted.append(heard("client", "/static"))
    for _ in range(3):
        reader = await place.client()
        for id in ("first", "second"):
            reader.send(listen("/static", id=id))
            got = [await reader.json() for _ in wanted]
            assert sorted(got, key=str) == wanted
            await reader.nothing()
    robot.publish(sample("new"))
    assert await reader.json() == heard("new", "/static")
    await reader.nothing()


@pytest.mark.parametrize(("given", "depth"), [("", 100), (',"queue_size":7', 7), (',"queue_size":0', 1)])
async def test_queue_size(place: Place, given: str, depth: int) -> None:
    """A topic is as deep as its queue size says; 0 is the least, and not the default."""
    client = await place.client()
    client.send('{"op":"advertise","topic":"/t","type":"std_msgs/String"' + given + "}")
    await client.done()
    assert [p.qos.depth for p in place.robot.topics()["/t"].publishers] == [depth]


# ── values ─────────────────────────────────────────────────────────────────────────────────────────────────────────


async def test_no_numbers(place: Place) -> None:
    """What is no number is null wherever it stands, so that every message is valid JSON."""
    codec = place.registry.codec(IMU)
    message = codec.default()
    message["orientation_covariance"] = [math.nan, math.inf, -math.inf, *[0.5] * 6]
    message["linear_acceleration"]["x"] = math.nan
    robot = await publisher(place, "/imu", LATCHED, IMU)
    robot.publish(Sample(codec.encode(message), IMU, 0, bytes(16), SEQ_NONE))
    client = await place.client()
    client.send({"op": "subscribe", "topic": "/imu"})
    got = await client.receive()
    assert b"NaN" not in got.data
    msg = got.json["msg"]
    assert msg["orientation_covariance"] == [None, None, None, *[0.5] * 6]
    assert msg["linear_acceleration"]["x"] is None


async def test_no_numbers_of_clients(place: Place) -> None:
    """Null and the literals that Python writes stand for what is no number."""
    inbox = Inbox()
    await place.robot.create_subscription("/floats", FLOATS, QoS(), inbox)
    client = await place.client()
    client.send({"op": "advertise", "topic": "/floats", "type": "std_msgs/Float64MultiArray"})
    client.send('{"op":"publish","topic":"/floats","msg":{"data":[null,NaN,Infinity,-Infinity,1]}}')
    await inbox.wait(1)
    values = struct.unpack_from("<5d", inbox.payloads[0], len(inbox.payloads[0]) - 40)
    assert [str(v) for v in values] == ["nan", "nan", "inf", "-inf", "1.0"]


async def test_long_integers(place: Place) -> None:
    """Integers of 64 bits are numbers, as from rosbridge, and texts for a client that asks for that in its URL."""
    type = "std_msgs/msg/Int64MultiArray"
    robot = await publisher(place, "/longs", LATCHED, type)
    payload = place.registry.codec(type).from_json({"layout": {"data_offset": 7}, "data": [2**53 + 1, -(2**63)]})
    robot.publish(Sample(payload, type, 0, bytes(16), SEQ_NONE))
    await place.robot.create_service("/add", ADD, add)
    plain, exact = await place.client(), await place.client(path="/?int64=text")
    for client in (plain, exact):
        client.send({"op": "subscribe", "topic": "/longs"})
    assert (await plain.json())["msg"]["data"] == [2**53 + 1, -(2**63)]
    got = (await exact.json())["msg"]
    assert got == {"layout": {"dim": [], "data_offset": 7}, "data": ["9007199254740993", "-9223372036854775808"]}
    for client, sum in ((plain, 2**60), (exact, "1152921504606846976")):
        client.send({"op": "call_service", "service": "/add", "args": {"a": 2**60}})
        assert (await client.json())["values"] == {"sum": sum}


# ── clients that are slow, hostile or odd ──────────────────────────────────────────────────────────────────────────


async def test_client_that_does_not_read(place: Place) -> None:
    """While one client reads nothing of 64 MB that it asked for, others have what they asked for, in time."""
    robot = await publisher(place, "/big", QoS(depth=10))
    beat = await publisher(place, "/beat", QoS(depth=100))
    stuck, well = await place.client(receive_bytes=1 << 12), await place.client()
    stuck.send(listen("/big"))
    stuck.send(listen("/beat"))
    well.send(listen("/beat"))
    await until(lambda: sum(len(s.outputs) for s in place.server.sessions) == 3)
    big, in_time = sample("x" * (1 << 20)), 0
    for number in range(50):
        if number % 5 == 0:
            for _ in range(6):
                robot.publish(big)
        beat.publish(sample(str(number)))
        watch, before_s = Stopwatch(), time.process_time()
        assert await well.json() == heard(str(number), "/beat")
        assert watch.seconds < 0.1  # on a loop that does not wait: it did not depend on any timer
        in_time += time.process_time() - before_s < 1.0
    assert in_time >= 45
    well.send({"op": "call_service", "service": "/nowhere", "id": "still"})
    assert (await well.json())["id"] == "still"


async def test_caller_that_does_not_read(place: Place) -> None:
    """A client that does not read its answers costs a bounded amount of memory, and others nothing."""

    async def big(request: Request) -> bytes:
        return text("x" * (1 << 20))

    await place.robot.create_service("/big", "example_interfaces/srv/Trigger", big)
    stuck, well = await place.client(receive_bytes=1 << 12), await place.client()
    for number in range(200):
        stuck.send({"op": "call_service", "service": "/big", "id": number})
    for number in range(20):
        well.send({"op": "call_service", "service": "/nowhere", "id": number})
        assert (await well.json())["id"] == number


async def test_ros_sharp(place: Place) -> None:
    """The frames of ROS#, binary JSON in pieces of 1024 bytes with null ids, are taken for a whole conversation."""
    client = await place.client()

    def send(**op: Any) -> None:
        client.send_pieces(BINARY, json.dumps(op).encode(), 1024)

    options = {"throttle_rate": 0, "queue_length": 1, "fragment_size": 2147483647, "compression": "none"}
    send(op="subscribe", id="/chatter:1", topic="/chatter", type="std_msgs/String", **options)
    send(op="advertise", id="/chatter:2", topic="/chatter", type="std_msgs/String")
    send(op="publish", id="/chatter:2", topic="/chatter", msg={"data": "y" * 5000})
    assert await client.json() == heard("y" * 5000)
    send(op="advertise_service", id=None, service="/add", type="example_interfaces/AddTwoInts")
    send(op="call_service", id="1", service="/add", args={"a": 1, "b": 2}, fragment_size=2147483647, compression="none")
    request = await client.json()
    assert request["args"] == {"a": 1, "b": 2}
    send(op="service_response", id=request["id"], service="/add", values={"sum": 3}, result=True)
    assert (await client.json())["values"] == {"sum": 3}
    send(op="unadvertise_service", id=None, service="/add")
    send(op="unsubscribe", id="/chatter:1", topic="/chatter")
    send(op="publish", id="/chatter:2", topic="/chatter", msg={"data": "gone"})
    await client.nothing()
    assert place.complaints == {}


# ── what rosbridge takes, besides ──────────────────────────────────────────────────────────────────────────────────


@pytest.mark.parametrize("type", ["std_msgs/srv/String", "std_msgs/action/String", "/std_msgs//msg/String/"])
async def test_middle_of_a_message_type(place: Place, type: str) -> None:
    """The middle part of a type says nothing that the operation does not say."""
    client = await place.client()
    client.send({"op": "advertise", "topic": "/t", "type": type})
    await until(lambda: "/t" in place.robot.topics())
    assert place.robot.topics()["/t"].types == (STRING,)
    client.send({"op": "subscribe", "topic": "/t", "type": type})
    client.send(said("x", "/t"))
    assert await client.json() == heard("x", "/t")
    assert place.complaints == {}


async def test_middle_of_other_types(place: Place) -> None:
    """Services and actions are found, too, by a type with another middle part."""
    client = await place.client()
    client.send({"op": "advertise_service", "service": "/s", "type": "std_srvs/msg/Trigger"})
    client.send({"op": "advertise_action", "action": "/a", "type": "example_interfaces/msg/Fibonacci"})
    await until(lambda: "/s" in place.robot.services() and "/a" in place.robot.actions())
    assert place.robot.services()["/s"].types == ("std_srvs/srv/Trigger",)
    assert place.robot.actions()["/a"].types == ("example_interfaces/action/Fibonacci",)
    other = await place.client()
    other.send({"op": "send_action_goal", "action": "/a", "action_type": "example_interfaces/srv/Fibonacci"})
    asked = await client.json()
    assert (asked["op"], asked["action_type"]) == ("send_action_goal", "example_interfaces/msg/Fibonacci")


@pytest.mark.parametrize(
    ("qos", "wanted"),
    [
        ({"durability": "transient_local"}, QoS(durability="transient_local", depth=1)),
        ({"durability": "best_available"}, QoS(durability="transient_local", depth=1)),
        ({"durability": "transient_local", "depth": 7}, QoS(durability="transient_local", depth=7)),
        ({"reliability": "best_effort", "liveliness": "manual"}, QoS(reliability="best_effort")),
    ],
    ids=str,
)
async def test_qos_of_a_publisher(place: Place, qos: dict[str, Any], wanted: QoS) -> None:
    """Who keeps messages for late readers keeps one unless told; what is unknown is ignored."""
    client = await place.client()
    client.send({"op": "advertise", "topic": "/t", "type": "std_msgs/String", "qos": qos})
    await until(lambda: "/t" in place.robot.topics())
    assert [p.qos for p in place.robot.topics()["/t"].publishers] == [wanted]


async def test_topics_of_an_action(place: Place) -> None:
    """The feedback and the status of an action can be read without telling their types."""
    await place.robot.create_action_server("/fib", FIBONACCI, ActionHandlers(count))
    client = await place.client()
    client.send({"op": "subscribe", "topic": "/fib/_action/feedback"})
    client.send({"op": "subscribe", "topic": "fib/_action/status"})
    client.send({"op": "send_action_goal", "action": "/fib", "action_type": FIBONACCI, "args": [2]})
    heard: dict[str, Any] = {}
    while "action_result" not in heard or heard.get("fib/_action/status") != [4]:
        got = await client.json()
        if got["op"] == "action_result":
            heard["action_result"] = got
        elif got["topic"] == "fib/_action/status":
            heard[got["topic"]] = [goal["status"] for goal in got["msg"]["status_list"]]
        else:
            heard[got["topic"]] = got["msg"]["feedback"]
    assert heard["/fib/_action/feedback"] == {"sequence": [0, 1]}
    client.send({"op": "subscribe", "topic": "/fib/_action/nothing"})
    await client.nothing()


async def test_true_is_a_number(place: Place) -> None:
    """A float field takes true and false for 1 and 0, an integer field does not."""
    inbox = Inbox()
    await place.robot.create_subscription("/f", "std_msgs/msg/Float64", None, inbox)
    client = await place.client()
    client.send({"op": "advertise", "topic": "/f", "type": "std_msgs/Float64"})
    client.send({"op": "advertise", "topic": "/i", "type": "std_msgs/Int64"})
    client.send({"op": "publish", "topic": "/f", "msg": {"data": True}})
    client.send({"op": "publish", "topic": "/i", "msg": {"data": True}})
    (got,) = await inbox.wait(1)
    assert got.payload == b"\0\1\0\0" + struct.pack("<d", 1.0)
    await until(lambda: place.complaints)


# ── who may do what ────────────────────────────────────────────────────────────────────────────────────────────────


class Deny(Access):
    """Allows what concerns ``/free`` only, and keeps what was asked."""

    def __init__(self) -> None:
        super().__init__()
        self.asked: list[tuple[str, str]] = []

    def check(self, verb: str, name: str) -> None:
        self.asked.append((verb, name))
        if name != "/free":
            raise AccessDenied(verb, name, "the test does not want it")


async def denied(place: Place, **options: Any) -> tuple[Client, Deny]:
    client = await place.client(**options)
    await client.done()
    deny = Deny()
    place.session.access = deny
    return client, deny


async def test_denials_are_answered(place: Place) -> None:
    """Requests that are not allowed are answered with the rule; everything is asked by its absolute name."""
    client, deny = await denied(place)
    client.send({"op": "call_service", "service": "shut#i", "id": 1})
    client.send({"op": "send_action_goal", "action": "shut", "action_type": "example_interfaces/Fibonacci", "id": 2})
    got = [await client.json(), await client.json()]
    assert [(g["op"], g["id"], g["result"]) for g in got] == [
        ("service_response", 1, False),
        ("action_result", 2, False),
    ]
    assert got[0]["values"] == "call service /shut: not allowed: the test does not want it"
    assert deny.asked == [("call_service", "/shut"), ("send_action_goal", "/shut")]


async def test_denials_without_an_answer(place: Place) -> None:
    """What has no answer is counted, and told to a client that wants to know; nothing comes of it."""
    client, deny = await denied(place, path="/?status=1")
    for op in (
        {**CHATTER, "topic": "shut", "id": "i"},
        {"op": "publish", "topic": "/shut", "type": "std_msgs/String", "msg": {}, "id": "i"},
        {"op": "subscribe", "topic": "/shut", "id": "i"},
        {"op": "advertise_service", "service": "/shut", "type": "std_srvs/Empty", "id": "i"},
        {"op": "advertise_action", "action": "/shut", "type": "example_interfaces/Fibonacci", "id": "i"},
    ):
        client.send(op)
        got = await client.json()
        assert (got["op"], got["level"], got["id"]) == ("status", "error", "i")
        assert got["msg"].endswith(" /shut: not allowed: the test does not want it")
    assert [verb for verb, _ in deny.asked] == [
        "publish",
        "publish",
        "subscribe",
        "advertise_service",
        "advertise_action",
    ]
    client.send({**CHATTER, "topic": "/free"})
    client.send(listen("/free"))
    client.send(said("allowed", "/free"))
    assert await client.json() == heard("allowed", "/free")
    assert "/shut" not in place.robot.topics()
    assert place.robot.services() == {}


# ── rosapi ─────────────────────────────────────────────────────────────────────────────────────────────────────────


@pytest.mark.parametrize("spelling", ["/rosapi/get_time", "rosapi/get_time", "rosapi/get_time#x"])
async def test_rosapi(place: Place, spelling: str) -> None:
    """The services of rosapi are answered under both spellings of their names, with the name as sent."""
    client = await place.client()
    client.send({"op": "call_service", "service": spelling, "type": "rosapi/GetTime", "args": {}, "id": "i"})
    got = await client.json()
    assert list(got) == ["op", "service", "values", "result", "id"]
    assert (got["service"], got["result"], got["id"]) == (spelling, True, "i")
    assert got["values"]["time"]["sec"] > 1_700_000_000
