"""rosapi answers each of its services as the original does."""

from __future__ import annotations

import asyncio
from typing import Any

import pytest

from ropeway.errors import CallFailed, NotServed
from ropeway.graph.calls import ActionHandlers, Outcome, Request, ServerGoal
from ropeway.listener.globs import Globs
from ropeway.networks.rosbridge.rosapi import SERVICES
from tests.support.actions import FIBONACCI
from tests.support.inbox import Inbox
from tests.support.messages import STRING

from .conftest import Place

pytestmark = pytest.mark.jumping

IMAGE = "sensor_msgs/msg/Image"
SET_BOOL = "std_srvs/srv/SetBool"


async def nothing(request: Request) -> bytes:
    raise AssertionError("nobody calls this")


async def never(goal: ServerGoal) -> Outcome:
    raise AssertionError("nobody asks for this")


@pytest.fixture
async def busy(place: Place) -> Place:
    """A robot that publishes, reads and serves."""
    robot = place.robot
    await robot.create_publisher("/chatter", STRING)
    await robot.create_publisher("/camera/image", IMAGE)
    await robot.create_publisher("/_hidden", STRING)
    await robot.create_subscription("/camera/_private/x", STRING, None, Inbox())
    await robot.create_subscription("/cmd", STRING, None, Inbox())
    await robot.create_service("/lamp", SET_BOOL, nothing)
    await robot.create_service("/_secret", SET_BOOL, nothing)
    await robot.create_action_server("/fibonacci", FIBONACCI, ActionHandlers(never))
    return place


OWN = sorted(f"/rosapi/{name}" for name in SERVICES)

ANSWERS: list[tuple[str, dict[str, Any], dict[str, Any]]] = [
    ("topics", {}, {"topics": ["/camera/image", "/chatter", "/cmd"], "types": [IMAGE, STRING, STRING]}),
    ("topics_for_type", {"type": STRING}, {"topics": ["/chatter", "/cmd"]}),
    ("topics_for_type", {"type": "std_msgs/String"}, {"topics": []}),
    ("services", {}, {"services": ["/lamp", *OWN]}),
    ("services_for_type", {"type": SET_BOOL}, {"services": ["/lamp"]}),
    ("services_for_type", {"type": "rosapi_msgs/srv/GetTime"}, {"services": ["/rosapi/get_time"]}),
    ("services_for_type", {"type": "std_srvs/SetBool"}, {"services": []}),
    ("nodes", {}, {"nodes": ["/gateway", "/robot"]}),
    (
        "node_details",
        {"node": "/robot"},
        {"subscribing": ["/cmd"], "publishing": ["/camera/image", "/chatter"], "services": ["/lamp"]},
    ),
    ("node_details", {"node": "/nobody"}, {"subscribing": [], "publishing": [], "services": []}),
    ("node_details", {}, {"subscribing": [], "publishing": [], "services": []}),
    ("action_servers", {}, {"action_servers": ["/fibonacci"]}),
    ("action_type", {"action": "/fibonacci"}, {"type": FIBONACCI}),
    ("action_type", {"action": "/nothing"}, {"type": ""}),
    ("topic_type", {"topic": "/chatter"}, {"type": STRING}),
    ("topic_type", {"topic": "chatter"}, {"type": STRING}),
    ("topic_type", {"topic": "/_hidden"}, {"type": ""}),
    ("topic_type", {"topic": "/nothing"}, {"type": ""}),
    ("topic_type", {}, {"type": ""}),
    ("service_type", {"service": "/lamp"}, {"type": SET_BOOL}),
    ("service_type", {"service": "/_secret"}, {"type": ""}),
    ("service_type", {"service": "/nothing"}, {"type": ""}),
    ("service_type", {"service": "/rosapi/topics"}, {"type": "rosapi_msgs/srv/Topics"}),
    ("publishers", {"topic": "/chatter"}, {"publishers": ["/robot"]}),
    ("publishers", {"topic": "/cmd"}, {"publishers": []}),
    ("publishers", {"topic": "/_hidden"}, {"publishers": []}),
    ("subscribers", {"topic": "/cmd"}, {"subscribers": ["/robot"]}),
    ("subscribers", {"topic": "/nothing"}, {"subscribers": []}),
    ("service_providers", {"service": SET_BOOL}, {"providers": ["/robot"]}),
    ("service_providers", {"service": "/lamp"}, {"providers": ["/robot"]}),
    ("service_providers", {"service": "rosapi_msgs/srv/Topics"}, {"providers": ["/gateway"]}),
    ("service_providers", {"service": "no/srv/Such"}, {"providers": []}),
    ("service_node", {"service": "/lamp"}, {"node": "/robot"}),
    ("service_node", {"service": "/rosapi/topics"}, {"node": "/gateway"}),
    ("service_node", {"service": "/nothing"}, {"node": ""}),
    ("message_details", {"type": "no_such/Message"}, {"typedefs": []}),
    ("message_details", {"type": "string"}, {"typedefs": []}),
    ("message_details", {"type": ""}, {"typedefs": []}),
    ("service_request_details", {"type": "no_such/Service"}, {"typedefs": []}),
    ("service_response_details", {"type": "std_msgs/msg/String"}, {"typedefs": []}),
    ("action_goal_details", {"type": "/"}, {"typedefs": []}),
]


@pytest.mark.parametrize(("service", "args", "values"), ANSWERS, ids=lambda v: v if isinstance(v, str) else "")
async def test_answers(busy: Place, service: str, args: dict[str, Any], values: dict[str, Any]) -> None:
    """What is asked is told exactly, what is hidden is left out, and what is unknown is told as nothing."""
    answer = await busy.ask(service, **args)
    assert answer == values
    assert list(answer) == list(values)


def typedef(type: str, fields: dict[str, tuple[str, int, str]]) -> dict[str, Any]:
    """A TypeDef without constants."""
    return {
        "type": type,
        "fieldnames": list(fields),
        "fieldtypes": [field[0] for field in fields.values()],
        "fieldarraylen": [field[1] for field in fields.values()],
        "examples": [field[2] for field in fields.values()],
        "constnames": [],
        "constvalues": [],
    }


SEQUENCE = {"sequence": ("int32", 0, "[]")}
TIME = typedef("builtin_interfaces/Time", {"sec": ("int32", -1, "0"), "nanosec": ("uint32", -1, "0")})
DETAILS: list[tuple[str, str, list[dict[str, Any]]]] = [
    (
        "message_details",
        "std_msgs/Header",
        [
            typedef(
                "std_msgs/Header", {"stamp": ("builtin_interfaces/Time", -1, "{}"), "frame_id": ("string", -1, "")}
            ),
            TIME,
        ],
    ),
    ("message_details", "time", [typedef("time", {"secs": ("int32", -1, "0"), "nsecs": ("int32", -1, "0")})]),
    (
        "service_request_details",
        "std_srvs/SetBool",
        [typedef("std_srvs/SetBool_Request", {"data": ("boolean", -1, "False")})],
    ),
    (
        "service_response_details",
        SET_BOOL,
        [typedef("std_srvs/SetBool_Response", {"success": ("boolean", -1, "False"), "message": ("string", -1, "")})],
    ),
    ("service_request_details", "std_srvs/Empty", [typedef("std_srvs/Empty_Request", {})]),
    ("action_goal_details", FIBONACCI, [typedef("example_interfaces/Fibonacci_Goal", {"order": ("int32", -1, "0")})]),
    (
        "action_result_details",
        "example_interfaces/Fibonacci",
        [typedef("example_interfaces/Fibonacci_Result", SEQUENCE)],
    ),
    ("action_feedback_details", FIBONACCI, [typedef("example_interfaces/Fibonacci_Feedback", SEQUENCE)]),
]


@pytest.mark.parametrize(("service", "type", "typedefs"), DETAILS)
async def test_details(place: Place, service: str, type: str, typedefs: list[dict[str, Any]]) -> None:
    """A message, or a part of a service or action, is described with all that it is made of."""
    assert await place.ask(service, type=type) == {"typedefs": typedefs}


async def test_interfaces(place: Place) -> None:
    """All known interfaces are listed under their full names."""
    listed = (await place.ask("interfaces"))["interfaces"]
    assert {STRING, SET_BOOL, FIBONACCI, "rosapi_msgs/srv/Topics", "rosbridge_msgs/msg/ConnectedClients"} <= set(listed)
    assert listed == sorted(listed)


async def test_time(bare: Place) -> None:
    """The time is told with the names of ROS 2, and with those of ROS 1 that roslibpy reads."""
    await bare.start(clock=lambda: 5_000_000_007)
    assert await bare.ask("get_time") == {"time": {"sec": 5, "nanosec": 7, "secs": 5, "nsecs": 7}}


async def test_version(place: Place, monkeypatch: pytest.MonkeyPatch) -> None:
    """The version is 2, the distribution that of the environment, or else that of the types."""
    monkeypatch.setenv("ROS_DISTRO", "humble")
    assert await place.ask("get_ros_version") == {"version": 2, "distro": "humble"}
    monkeypatch.delenv("ROS_DISTRO")
    assert await place.ask("get_ros_version") == {"version": 2, "distro": place.registry.distro}


async def test_topics_and_raw_types(busy: Place) -> None:
    """Every topic comes with the text of its type and of all that it is made of."""
    answer = await busy.ask("topics_and_raw_types")
    assert list(answer) == ["topics", "types", "typedefs_full_text"]
    assert answer["topics"] == ["/camera/image", "/chatter", "/cmd"]
    assert answer["types"] == [IMAGE, STRING, STRING]
    image, first, second = answer["typedefs_full_text"]
    assert first == second == busy.registry.full_text(STRING)
    rule = "=" * 80
    assert f"\n{rule}\nMSG: std_msgs/Header\n" in image
    assert f"\n{rule}\nMSG: builtin_interfaces/Time\n" in image


async def test_new_topics_are_seen_at_once(busy: Place) -> None:
    """No answer is older than the graph."""
    assert "/new" not in (await busy.ask("topics_and_raw_types"))["topics"]
    publisher = await busy.robot.create_publisher("/new", STRING)
    assert "/new" in (await busy.ask("topics_and_raw_types"))["topics"]
    await publisher.close()
    assert "/new" not in (await busy.ask("topics"))["topics"]


async def test_what_clients_do_is_seen_at_once(place: Place) -> None:
    """The details of the gateway's own node tell what a client has created a moment ago."""
    view = place.hub.view("a client")
    for number in range(5):
        name = f"/topic{number}"
        assert name not in (await place.ask("node_details", node="/gateway"))["publishing"]
        await view.create_publisher(name, STRING)
        assert name in (await place.ask("node_details", node="/gateway"))["publishing"]


async def test_a_topic_without_a_definition(place: Place) -> None:
    """A type that nobody knows is told in a comment, and spoils no other."""
    await place.robot.create_publisher("/known", STRING)
    await place.robot.create_publisher("/strange", "far_away/msg/Thing")
    answer = await place.ask("topics_and_raw_types")
    assert answer["topics"] == ["/known", "/strange"]
    text = answer["typedefs_full_text"][1]
    assert text.startswith("# failed to get full definition text for far_away/msg/Thing: ")
    assert "\n" not in text


async def test_hidden_nodes(place: Place) -> None:
    """Nodes whose names begin with an underscore are not listed, nor what they publish as theirs."""
    tool = await place.participant("/_ros2cli_17")
    await tool.create_publisher("/chatter", STRING)
    assert (await place.ask("nodes"))["nodes"] == ["/gateway", "/robot"]
    assert (await place.ask("publishers", topic="/chatter"))["publishers"] == []
    assert (await place.ask("node_details", node="/_ros2cli_17"))["publishing"] == []


async def test_waiting_clients_serve_nothing(place: Place) -> None:
    """A service or action that only somebody waits for is not listed; the type of the action is told."""
    await place.robot.create_client("/wanted", SET_BOOL)
    await place.robot.create_action_client("/wished", FIBONACCI)
    assert "/wanted" not in (await place.ask("services"))["services"]
    assert (await place.ask("service_type", service="/wanted")) == {"type": ""}
    assert (await place.ask("action_servers"))["action_servers"] == []


async def test_many_details_at_once(busy: Place) -> None:
    """A hundred questions for the details of nodes are answered, each with its own."""
    nodes = [f"/node{number}" for number in range(20)]
    for node in nodes:
        await (await busy.participant(node)).create_publisher(f"{node}/out", STRING)
    asked = nodes * 5
    answers = await asyncio.gather(*(busy.ask("node_details", node=node) for node in asked))
    assert [answer["publishing"] for answer in answers] == [[f"{node}/out"] for node in asked]


@pytest.mark.parametrize(
    ("globs", "topics"),
    [
        (Globs(), ["/camera/image", "/chatter", "/cmd"]),
        (Globs(topics_pub=["/c*"]), ["/camera/image", "/chatter", "/cmd"]),
        (Globs(topics_pub=["/cmd"], topics_sub=["/camera/*"]), ["/camera/image", "/cmd"]),
        (Globs(topics_pub=[], topics_sub=[]), []),
    ],
)
async def test_topic_globs(bare: Place, globs: Globs, topics: list[str]) -> None:
    """Topics are listed that may be published or read; one list alone hides nothing."""
    await bare.start(globs=globs)
    for name in ("/chatter", "/camera/image", "/cmd"):
        await bare.robot.create_publisher(name, STRING)
    assert (await bare.ask("topics"))["topics"] == topics
    assert (await bare.ask("topics_and_raw_types"))["topics"] == topics
    assert (await bare.ask("topics_for_type", type=STRING))["topics"] == topics
    for name in ("/chatter", "/camera/image", "/cmd"):
        assert (await bare.ask("topic_type", topic=name))["type"] == (STRING if name in topics else "")


async def test_globs_of_users(bare: Place) -> None:
    """Publishers are told of topics that may be published, subscribers of those that may be read."""
    await bare.start(globs=Globs(topics_pub=["/cmd"], topics_sub=["/chatter"]))
    for name in ("/chatter", "/cmd"):
        await bare.robot.create_publisher(name, STRING)
        await bare.robot.create_subscription(name, STRING, None, Inbox())
    assert (await bare.ask("publishers", topic="/cmd"))["publishers"] == ["/robot"]
    assert (await bare.ask("publishers", topic="/chatter"))["publishers"] == []
    assert (await bare.ask("subscribers", topic="/cmd"))["subscribers"] == []
    assert (await bare.ask("subscribers", topic="/chatter"))["subscribers"] == ["/robot"]


async def test_service_globs(bare: Place) -> None:
    """Services that a glob hides are unknown in every question, those of rosapi too."""
    await bare.start(globs=Globs(services=["/lamp"]))
    await bare.robot.create_service("/lamp", SET_BOOL, nothing)
    await bare.robot.create_service("/door", SET_BOOL, nothing)
    assert (await bare.ask("services"))["services"] == ["/lamp"]
    assert (await bare.ask("services_for_type", type=SET_BOOL))["services"] == ["/lamp"]
    assert (await bare.ask("service_type", service="/door"))["type"] == ""
    assert (await bare.ask("service_node", service="/door"))["node"] == ""
    assert (await bare.ask("service_node", service="/lamp"))["node"] == "/robot"
    assert (await bare.ask("service_providers", service=SET_BOOL))["providers"] == []


async def test_action_globs(bare: Place) -> None:
    """Action servers are listed whose topics may be seen."""
    await bare.start(globs=Globs(topics_pub=["/open/*"], topics_sub=[]))
    for name in ("/open", "/shut"):
        await bare.robot.create_action_server(name, FIBONACCI, ActionHandlers(never))
    assert (await bare.ask("action_servers"))["action_servers"] == ["/open"]


@pytest.mark.parametrize("name", ["/rosapi/topic_type", "rosapi/topic_type"])
@pytest.mark.parametrize("args", [{"topic": "/chatter"}, ["/chatter"], ["/chatter", "more"]])
async def test_names_and_arguments(busy: Place, name: str, args: object) -> None:
    """Both spellings of a name are served, and arguments may come in a list."""
    assert busy.rosapi.serves(name)
    assert await busy.rosapi.call(name, args) == {"type": STRING}


@pytest.mark.parametrize("args", [None, [], {}, "text", 5, {"topic": None}])
async def test_no_arguments(place: Place, args: object) -> None:
    """What is not an object or a list of arguments is as good as none, and null is as good as no argument."""
    assert await place.rosapi.call("/rosapi/topic_type", args) == {"type": ""}


@pytest.mark.parametrize(
    ("args", "reason"),
    [
        ({"topic": 5}, "requires a string for field topic"),
        ({"nothing": ""}, "does not have a field nothing"),
        ([["/chatter"]], "topic"),
    ],
)
async def test_bad_arguments(place: Place, args: object, reason: str) -> None:
    """Arguments that do not fit the request fail the call with the reason."""
    with pytest.raises(CallFailed, match=reason):
        await place.rosapi.call("/rosapi/topic_type", args)


@pytest.mark.parametrize(
    "name", ["/rosapi/what", "rosapi", "/rosapi/", "/topics", "", "/robot1/rosapi/topics", "/rosapi/topics/"]
)
async def test_other_names(place: Place, name: str) -> None:
    """Every other name is not served."""
    assert not place.rosapi.serves(name)
    with pytest.raises(NotServed, match="does not exist"):
        await place.rosapi.call(name)


async def test_namespace(bare: Place) -> None:
    """In a namespace the services stand below it, and nowhere else."""
    await bare.start(namespace="/robot1")
    assert bare.rosapi.serves("/robot1/rosapi/topics")
    assert not bare.rosapi.serves("/rosapi/topics")
    assert "/robot1/rosapi/topics" in (await bare.rosapi.call("robot1/rosapi/services"))["services"]


async def test_fields_are_those_of_the_definitions(busy: Place) -> None:
    """Every answer has the fields of its type, in order, with values of their types."""
    for name, type in SERVICES.items():
        answer = await busy.ask(name)
        codec = busy.registry.codec(f"{type}_Response")
        assert tuple(answer) == codec.fields, name
        assert codec.from_json(answer), name
