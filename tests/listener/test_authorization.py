"""ropeway.listener.authorization: what a role, a glob and a rate allow, and how a client hears that they do not."""

from __future__ import annotations

import logging
from collections import Counter
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from ropeway.errors import AccessDenied
from ropeway.listener.authentication import Door
from ropeway.listener.authorization import EVERYTHING, VERBS, Access, Globs, Role
from ropeway.networks.rosbridge.rosapi import SERVICES
from ropeway.qos import QoS
from tests.support.messages import STRING
from tests.support.place import Place
from tests.support.until import until
from tests.support.websocket import Client

pytestmark = pytest.mark.jumping

NAMES = st.from_regex(r"/[a-z_]{1,5}(/[a-z_]{1,5}){0,2}", fullmatch=True)
VIEWER = Role(
    "viewer",
    {
        "subscribe": ("*",),
        "publish": ("/cmd_vel", "chat/*"),
        "call_service": ("/reset",),
        "send_action_goal": ("/dock",),
    },
    {"subscribe": ("/secret", "/secret/*")},
)


ROSAPI = frozenset(f"/rosapi/{name}" for name in SERVICES).__contains__


def denied(access: Access, verb: str, name: str) -> str:
    with pytest.raises(AccessDenied) as error:
        access.check(verb, name)
    assert (error.value.verb, error.value.name) == (verb, name)
    return error.value.rule


# ── rules ──────────────────────────────────────────────────────────────────────────────────────────────────────────


@given(st.sampled_from(VERBS), NAMES)
def test_everything(verb: str, name: str) -> None:
    """Without rules everything is allowed."""
    Access().check(verb, name)
    assert Access(EVERYTHING).allows(verb, name)


@given(st.sampled_from(VERBS), NAMES)
def test_nothing(verb: str, name: str) -> None:
    """A role that lists nothing allows nothing."""
    assert not Access(Role("none", {})).allows(verb, name)


def test_patterns() -> None:
    """A name needs a pattern of the verb, with or without the slash; ``deny`` goes first; a star takes slashes."""
    access = Access(VIEWER)
    for verb, name in [
        ("subscribe", "/a/b/c"),
        ("subscribe", "/secretary"),
        ("publish", "/cmd_vel"),
        ("publish", "cmd_vel"),
        ("publish", "/chat/a/b"),
        ("call_service", "/reset"),
    ]:
        access.check(verb, name)
    assert denied(access, "publish", "/cmd_vel2") == "role viewer does not list it under publish"
    assert denied(access, "publish", "/x/cmd_vel") == "role viewer does not list it under publish"
    assert denied(access, "subscribe", "/secret/plan") == "role viewer denies /secret/*"
    assert denied(access, "subscribe", "secret") == "role viewer denies /secret"
    assert denied(access, "advertise_service", "/reset") == "role viewer does not list it under advertise_service"


def test_parts_of_an_action() -> None:
    """The hidden services and topics of an action need the right to the action, and give no way around it."""
    access = Access(Role("r", {"send_action_goal": ("/dock",), "call_service": ("*",), "advertise_service": ("*",)}))
    for part in ("send_goal", "cancel_goal", "get_result"):
        access.check("call_service", f"/dock/_action/{part}")
        denied(access, "call_service", f"/fly/_action/{part}")
        denied(access, "advertise_service", f"/dock/_action/{part}")
    provider = Access(Role("p", {"advertise_action": ("/dock",), "publish": ("*",)}))
    provider.check("publish", "/dock/_action/feedback")
    denied(provider, "publish", "/fly/_action/status")


def test_rosapi() -> None:
    """A role may ask rosapi, in both spellings, unless it is denied; changing parameters is a call like others."""
    access = Access(Role("r", {}), Globs(services=()), is_own=ROSAPI)
    for name in ("/rosapi/topics", "rosapi/nodes", "/rosapi/get_param"):
        access.check("call_service", name)
    denied(access, "call_service", "/rosapi/set_param")
    denied(access, "call_service", "rosapi/delete_param")
    denied(access, "advertise_service", "/rosapi/topics")
    denied(Access(Role("r", {}, {"call_service": ("/rosapi/*",)}), is_own=ROSAPI), "call_service", "/rosapi/topics")


@pytest.mark.parametrize(
    ("globs", "allowed", "refused"),
    [
        (Globs(topics_pub=("/a*",)), [("publish", "/ab"), ("subscribe", "/x")], [("publish", "/b")]),
        (Globs(topics_sub=("a",)), [("subscribe", "a"), ("subscribe", "/a")], [("subscribe", "/b")]),
        (Globs(services=("/s",)), [("call_service", "s")], [("call_service", "/t"), ("advertise_service", "/t")]),
        (Globs(services=()), [("publish", "/a")], [("advertise_service", "/s"), ("call_service", "/s")]),
        (Globs(actions=()), [("call_service", "/s")], [("send_action_goal", "/x"), ("advertise_action", "/x")]),
        (Globs(actions=()), [], [("call_service", "/x/_action/send_goal")]),
    ],
)
def test_globs(globs: Globs, allowed: list[tuple[str, str]], refused: list[tuple[str, str]]) -> None:
    """Rosbridge's globs filter every role; an empty one denies all, services and actions that are offered, too."""
    access = Access(EVERYTHING, globs)
    for verb, name in allowed:
        access.check(verb, name)
    for verb, name in refused:
        assert denied(access, verb, name).endswith("_glob")


def test_counts_and_log(caplog: pytest.LogCaptureFixture) -> None:
    """Every denial is counted by rule; the log names client, role, verb, name and rule, once a minute and rule."""
    now = [0.0]
    tally: Counter[str] = Counter()
    access = Access(VIEWER, client="10.0.0.1:5", tally=tally, clock=lambda: now[0])
    for i in range(100):
        denied(access, "publish", f"/x{i}")
    rule = "role viewer does not list it under publish"
    assert access.denied == tally == {rule: 100}
    assert caplog.messages == [f"10.0.0.1:5 (role viewer): denied: publish /x0: not allowed: {rule}"]
    now[0] = 61.0
    denied(access, "publish", "/y")
    assert "(99 more since the last such line)" in caplog.messages[-1]
    assert not access.allows("publish", "/z")
    assert access.denied[rule] == 101


def test_many_names() -> None:
    """What is remembered of a client that invents names is bounded."""
    access = Access(VIEWER)
    for i in range(5000):
        assert access.allows("subscribe", f"/n{i}")
    assert len(access._known) <= 1024


def test_rates() -> None:
    """A second's worth may come at once; then as much as the rate gives; something big goes once, and is paid for."""
    now = [0.0]
    role = Role("r", {}, messages_per_s=10, bytes_per_s=1000)
    access = Access(role, clock=lambda: now[0])
    assert access.limited
    for _ in range(10):
        access.spend("publish", "/x", 1)
    with pytest.raises(AccessDenied, match="role r has 10 messages per second at most"):
        access.spend("publish", "/x", 1)
    now[0] = 0.1
    access.spend("publish", "/x", 1)
    now[0] = 10.0
    access.spend("publish", "/x", 5000)
    now[0] = 13.5
    with pytest.raises(AccessDenied, match="role r has 1000 bytes per second at most"):
        access.spend("publish", "/x", 600)
    now[0] = 15.5
    access.spend("publish", "/x", 600)


def test_parts_of_ros1_actions() -> None:
    """On ROS 1 the topics of an action need the right to the action, and what denies its goals denies them."""
    actions = {"/navigate"}
    everything = ("/*",)

    def allowed(verb: str, name: str, **rights: Any) -> bool:
        role = Role("r", rights.get("allow", {}), rights.get("deny", {}))
        return Access(role, ros1_actions=lambda: actions).allows(verb, name)

    topics = {"publish": everything, "subscribe": everything}
    assert not allowed("publish", "/navigate/goal", allow=topics)
    assert not allowed("publish", "/navigate/feedback", allow=topics)
    assert allowed("publish", "/navigate/goal", allow={**topics, "send_action_goal": everything})
    assert allowed("publish", "/move_base_simple/goal", allow=topics)
    assert allowed("subscribe", "/navigate/status", allow=topics)
    for verb, name in (("publish", "/later/goal"), ("publish", "/later/cancel"), ("subscribe", "/later/result")):
        assert not allowed(verb, name, allow=topics, deny={"send_action_goal": ("/later",)})


def test_feedback_of_denied_actions() -> None:
    """Whoever may not use an action does not read its feedback either, also as a topic."""
    role = Role("r", {"subscribe": ("*",)}, {"send_action_goal": ("/navigate",)})
    assert not Access(role).allows("subscribe", "/navigate/_action/feedback")
    assert Access(role).allows("subscribe", "/dock/_action/status")


def test_services_beside_rosapi() -> None:
    """A service of a node needs the right to be called, also below /rosapi."""
    access = Access(Role("r", {}), is_own=ROSAPI)
    assert access.allows("call_service", "/rosapi/topics")
    assert not access.allows("call_service", "/rosapi/set_parameters")
    assert not access.allows("call_service", "/rosapi/set_param")
    namespaced = Access(Role("r", {}), is_own=lambda name: name.startswith("/robot1/rosapi/"))
    assert namespaced.allows("call_service", "/robot1/rosapi/topics")
    assert not namespaced.allows("call_service", "/robot1/rosapi/delete_param")
    assert not namespaced.allows("call_service", "/rosapi/topics")


# ── sessions ───────────────────────────────────────────────────────────────────────────────────────────────────────


async def start(place: Place, role: Role, globs: Globs | None = None) -> Client:
    await place.start(door=Door(default=role, globs=globs or Globs()))
    client = await place.client(path="/?status=1")
    await until(lambda: place.server.sessions)
    return client


@pytest.mark.parametrize(
    ("role", "globs", "topics"),
    [
        (EVERYTHING, Globs(), {"/seen", "/hidden"}),
        (Role("r", {"subscribe": ("/seen",)}), Globs(), {"/seen"}),
        (Role("r", {"publish": ("*",)}, {"publish": ("/hidden",)}), Globs(), {"/seen"}),
        (Role("r", {}), Globs(), set()),
        (EVERYTHING, Globs(topics_pub=("/seen",), topics_sub=("/seen",)), {"/seen"}),
    ],
)
async def test_what_a_gateway_is_shown(bare: Place, role: Role, globs: Globs, topics: set[str]) -> None:
    """A gateway that watches is shown what its role and the globs allow it anything with, and no other node."""
    await bare.start(door=Door(default=role, globs=globs))
    for name in ("/seen", "/hidden"):
        await bare.robot.create_publisher(name, STRING, QoS())
    client = await bare.client(subprotocol="ropeway.1")
    client.send({"op": "watch"})
    while (message := await client.json())["op"] != "graph":
        pass
    assert topics == message["topics"].keys() & {"/seen", "/hidden"}
    assert ("/robot" in message["nodes"]) is bool(topics)


async def answer(client: Client, op: dict[str, Any]) -> Any:
    client.send(op)
    return await client.json()


async def test_requests_are_answered(bare: Place) -> None:
    """A call and a goal that are not allowed are answered at once with the rule; other operations by a status."""
    client = await start(bare, VIEWER)
    reply = await answer(client, {"op": "call_service", "service": "/x", "id": "1"})
    rule = "not allowed: role viewer does not list it under"
    assert reply == {
        "op": "service_response",
        "service": "/x",
        "values": f"call service /x: {rule} call_service",
        "result": False,
        "id": "1",
    }
    goal = {"op": "send_action_goal", "action": "/x", "action_type": "example_interfaces/action/Fibonacci", "id": "2"}
    reply = await answer(client, goal)
    assert (reply["op"], reply["id"], reply["result"]) == ("action_result", "2", False)
    assert reply["values"] == f"send action goal /x: {rule} send_action_goal"
    for op, verb in (
        ({"op": "advertise", "topic": "/x", "type": STRING}, "publish"),
        ({"op": "publish", "topic": "/x", "type": STRING, "msg": {}}, "publish"),
        ({"op": "subscribe", "topic": "/secret", "type": STRING}, "subscribe"),
        ({"op": "advertise_service", "service": "/x", "type": "std_srvs/srv/Empty"}, "advertise_service"),
        ({"op": "advertise_action", "action": "/x", "type": goal["action_type"]}, "advertise_action"),
    ):
        reply = await answer(client, op)
        assert (reply["op"], reply["level"]) == ("status", "error")
        assert f"{verb.replace('_', ' ')} {'/secret' if verb == 'subscribe' else '/x'}: not allowed" in reply["msg"]
    status = bare.session.status()
    assert status["role"] == "viewer"
    assert sum(status["denied"].values()) == 7
    assert bare.server.status()["denied"] == status["denied"]
    assert not bare.complaints


async def test_what_is_allowed_works(bare: Place) -> None:
    """Beside what is denied, what is allowed goes on."""
    client = await start(bare, VIEWER)
    client.send({"op": "subscribe", "topic": "/cmd_vel", "type": STRING})
    client.send({"op": "publish", "topic": "cmd_vel", "type": STRING, "msg": {"data": "on"}})
    assert (await client.json())["msg"] == {"data": "on"}


async def test_rates_of_a_client(bare: Place) -> None:
    """Messages above the rate are dropped and counted, calls refused, and answers still taken."""
    role = Role("slow", dict.fromkeys(VERBS, ("*",)), messages_per_s=3)
    client = await start(bare, role)
    seen: list[Any] = []
    await bare.robot.create_subscription("/x", STRING, None, seen.extend)
    for i in range(20):
        client.send({"op": "publish", "topic": "/x", "type": STRING, "msg": {"data": str(i)}})
    client.send({"op": "call_service", "service": "/rosapi/get_time", "id": "1"})
    while (reply := await client.json())["op"] == "status":
        assert "role slow has 3 messages per second at most" in reply["msg"]
    assert (reply["id"], reply["result"]) == ("1", False)
    client.send({"op": "unadvertise", "topic": "/x"})
    await until(lambda: len(seen) == 3)
    assert bare.session.access.denied == {"role slow has 3 messages per second at most": 18}


async def test_size_of_a_message(bare: Place) -> None:
    """A message above the limit of the role closes its connection with 1009."""
    client = await start(bare, Role("small", dict.fromkeys(VERBS, ("*",)), max_message_bytes=1024))
    client.send({"op": "publish", "topic": "/x", "type": STRING, "msg": {"data": "x" * 2000}})
    assert (await client.closed())[0] == 1009


def test_the_log_is_quiet(caplog: pytest.LogCaptureFixture) -> None:
    """A long name is cut in what is said of it."""
    with pytest.raises(AccessDenied):
        Access(Role("r", {}), client="c").check("publish", "/" + "x" * 10_000)
    assert logging.WARNING in [record.levelno for record in caplog.records]
    assert len(caplog.messages[0]) < 400
