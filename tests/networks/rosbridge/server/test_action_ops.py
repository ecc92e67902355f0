"""server.action_ops and action_offers: conversations with a plain rosbridge client about actions."""

from __future__ import annotations

import asyncio
import struct
from typing import Any

import cbor2
import lz4.frame
import pytest

from ropeway import aio
from ropeway.errors import GoalRejected
from ropeway.graph.calls import ActionHandlers, ClientGoal, Goal, GoalStatus, Outcome, ServerGoal
from tests.support.actions import FIBONACCI, Worker, count, order, ordered, sequence
from tests.support.place import Place
from tests.support.until import PATIENCE_S, until
from tests.support.websocket import Client

pytestmark = pytest.mark.jumping

GOAL = '{"op":"send_action_goal","id":"send_action_goal:/fib:1","action":"/fib",'
TYPE = '"action_type":"example_interfaces/Fibonacci",'


async def serve(place: Place, execute: Any = count, name: str = "/fib", **more: Any) -> Any:
    """The robot carries out goals."""
    return await place.robot.create_action_server(name, FIBONACCI, ActionHandlers(execute, **more))


def goal(id: Any = "g", number: int = 3, **more: Any) -> dict[str, Any]:
    args = {"order": number}
    return {"op": "send_action_goal", "id": id, "action": "/fib", "action_type": FIBONACCI, "args": args, **more}


def result(status: int, *values: int, id: Any = "g") -> dict[str, Any]:
    return {
        "op": "action_result",
        "action": "/fib",
        "values": {"sequence": list(values)},
        "status": status,
        "result": True,
        "id": id,
    }


# ── sending goals ──────────────────────────────────────────────────────────────────────────────────────────────────


@pytest.mark.parametrize("type", ['"action_type":"example_interfaces/Fibonacci"', f'"type":"{FIBONACCI}"'])
async def test_goal_byte_for_byte(place: Place, type: str) -> None:
    """Feedback and result have their fields in the order in which rosbridge sends them."""
    await serve(place)
    client = await place.client()
    client.send(GOAL + type + ',"args":{"order":2},"feedback":true}')
    for values in (b"[0]", b"[0,1]"):
        assert (await client.receive()).data == (
            b'{"op":"action_feedback","action":"/fib","values":{"sequence":' + values + b"},"
            b'"id":"send_action_goal:/fib:1"}'
        )
    assert (await client.receive()).data == (
        b'{"op":"action_result","action":"/fib","values":{"sequence":[0,1]},"status":4,"result":true,'
        b'"id":"send_action_goal:/fib:1"}'
    )
    await client.nothing()
    assert place.complaints == {}


@pytest.mark.parametrize("more", ["", ',"feedback":false', ',"feedback":null', ',"feedback":0'])
async def test_no_feedback_unasked(place: Place, more: str) -> None:
    """Feedback comes only to who asks for it."""
    await serve(place)
    client = await place.client()
    client.send(GOAL + TYPE + '"args":[2]' + more + "}")
    assert (await client.json())["op"] == "action_result"
    await client.nothing()


async def test_names_and_ids(place: Place) -> None:
    """An action is named as the client did, ids come back as they were, and none if there was none."""
    await serve(place)
    client = await place.client()
    for name, more, id in [
        ("fib", "", ""),
        ("/fib#old", "", ',"id":"old"'),
        ("/fib", '"id":null,', ""),
        ("/fib", '"id":{"a":[1]},', ',"id":{"a":[1]}'),
    ]:
        client.send('{"op":"send_action_goal",' + more + TYPE + '"action":"' + name + '"}')
        assert (await client.receive()).data.decode() == (
            '{"op":"action_result","action":"' + name + '","values":{"sequence":[]},"status":4,"result":true' + id + "}"
        )


@pytest.mark.parametrize("status", [GoalStatus.SUCCEEDED, GoalStatus.CANCELED, GoalStatus.ABORTED])
async def test_outcomes(place: Place, status: GoalStatus) -> None:
    """The status tells how the goal ended; there is a result in any case."""

    async def execute(goal: ServerGoal) -> Outcome:
        return Outcome(status, sequence(7))

    await serve(place, execute)
    client = await place.client()
    client.send(goal())
    assert await client.json() == result(int(status), 7)


async def test_aborted_without_a_result(place: Place) -> None:
    """A goal that fails has the result with default values."""

    async def execute(goal: ServerGoal) -> Outcome:
        raise GoalRejected("not really")

    await serve(place, execute)
    client = await place.client()
    client.send(goal())
    assert await client.json() == result(6)


async def test_goals_that_are_not_carried_out(place: Place) -> None:
    """A goal that nobody takes, or that is none, is answered with status 0 and a text."""

    async def reject(goal: ServerGoal) -> bool:
        return False

    await serve(place, accept=reject)
    client = await place.client()
    for message, text in [
        ('"action":"/fib","args":[1],' + TYPE[:-1], "Action goal was rejected"),
        ('"action":"nobody",' + TYPE[:-1], "No action server available"),
        (
            '"action":"/fib","args":{"x":1},' + TYPE[:-1],
            "Message type example_interfaces/Fibonacci_Goal does not have a field x",
        ),
        ('"action":"/fib"', "send_action_goal: Expected a action_type field but none was found."),
        ('"action":"/fib","action_type":"tf2_msgs/LookupTransform"', None),
        ('"action":"/fib","action_type":"std_msgs/msg/String"', None),
        ('"action":"/nobody","action_type":"strange_msgs/Strange"', None),
        ('"action":7,' + TYPE[:-1], None),
    ]:
        client.send('{"op":"send_action_goal","id":"x",' + message + "}")
        got = await client.json()
        assert list(got) == ["op", "action", "values", "status", "result", "id"]
        assert (got["op"], got["status"], got["result"], got["id"]) == ("action_result", 0, False, "x")
        assert text is None or got["values"] == text
    await client.nothing()


async def test_cancel(place: Place) -> None:
    """A goal ends when its client asks for it, by its id or its old-style name; an unknown id is ignored."""
    worker = Worker()
    await serve(place, worker)
    client = await place.client()
    client.send(goal("a"))
    client.send(goal("b"))
    client.send({"op": "cancel_action_goal", "action": "/fib", "id": "c"})
    client.send({"op": "cancel_action_goal", "action": "/other", "id": "a"})
    client.send({"op": "cancel_action_goal", "action": "/fib", "id": "a"})
    assert await client.json() == result(5, 5, id="a")
    client.send({"op": "cancel_action_goal", "action": "fib#b"})
    assert await client.json() == result(5, 5, id="b")
    await client.nothing()
    assert place.complaints == {}


async def test_cancel_all(place: Place) -> None:
    """Without an id, all goals of this client on this action end, and nobody else's."""
    worker = Worker()
    await serve(place, worker)
    await serve(place, worker, "/other")
    client, other = await place.client(), await place.client()
    other.send(goal("theirs"))
    client.send(goal(1))
    client.send({**goal(None), "id": None})
    client.send({k: v for k, v in goal().items() if k != "id"})
    client.send(goal("o", action="/other"))
    client.send({"op": "cancel_action_goal", "action": "/fib"})
    got = [await client.json() for _ in range(3)]
    assert {g["status"] for g in got} == {5}
    await until(lambda: len(worker.goals) == 5)
    worker.finish.set()
    assert (await client.json())["id"] == "o"
    assert await other.json() == result(4, 4, id="theirs")


async def test_cancel_at_once(place: Place) -> None:
    """A goal that is cancelled before it was accepted ends as soon as it is."""
    gate = asyncio.Event()

    async def accept(goal: ServerGoal) -> bool:
        await gate.wait()
        return True

    await serve(place, Worker(), accept=accept)
    client = await place.client()
    client.send(goal())
    client.send({"op": "cancel_action_goal", "action": "/fib", "id": "g"})
    await client.done()
    gate.set()
    assert await client.json() == result(5, 5)


async def test_same_id_twice(place: Place) -> None:
    """Goals may have the same id; each has its result, and both end when that id is cancelled."""
    await serve(place, Worker())
    client = await place.client()
    client.send(goal())
    client.send(goal())
    await client.done()
    client.send({"op": "cancel_action_goal", "action": "/fib", "id": "g"})
    assert [await client.json(), await client.json()] == [result(5, 5)] * 2


async def test_client_leaves(place: Place) -> None:
    """The goals of a client that leaves are cancelled."""
    worker = Worker()
    await serve(place, worker)
    client = await place.client()
    client.send(goal())
    await until(lambda: worker.goals)
    client.abort()
    async with aio.timeout(PATIENCE_S):
        await worker.goals[0].cancelled.wait()
    await until(lambda: not place.server.sessions)


async def test_goals_may_go_on(place: Place) -> None:
    """The goals of a client that leaves go on where the server is told to let them."""
    place.server.cancel_goals = False
    worker = Worker()
    await serve(place, worker)
    client = await place.client()
    client.send(goal())
    await until(lambda: worker.goals)
    client.abort()
    await until(lambda: not place.server.sessions)
    assert not worker.goals[0].cancelled.is_set()


async def test_provider_on_the_network_leaves(place: Place) -> None:
    """A goal whose provider vanishes is aborted."""
    worker = Worker()
    server = await serve(place, worker)
    client = await place.client()
    client.send(goal())
    await until(lambda: worker.goals)
    await server.close()
    assert await client.json() == result(6)


async def test_too_many_goals(place: Place, monkeypatch: pytest.MonkeyPatch) -> None:
    """A client may have so many goals under way; what is above is refused at once."""
    from ropeway.networks.rosbridge.server import action_ops

    monkeypatch.setattr(action_ops, "GOALS_PER_CLIENT", 5)
    worker = Worker()
    await serve(place, worker)
    client = await place.client()
    for number in range(7):
        client.send(goal(number))
    refused = [await client.json(), await client.json()]
    assert [(r["id"], r["status"], r["result"]) for r in refused] == [(5, 0, False), (6, 0, False)]
    await until(lambda: len(worker.goals) == 5)
    worker.finish.set()
    assert {(await client.json())["id"] for _ in range(5)} == set(range(5))


# ── carrying goals out ─────────────────────────────────────────────────────────────────────────────────────────────


async def offer(place: Place, name: str = "/fib", type: str = "example_interfaces/Fibonacci", **more: Any) -> Client:
    """A client that carries out goals."""
    client = await place.client()
    client.send({"op": "advertise_action", "action": name, "type": type, **more})
    await client.done()
    return client


class Feedback:
    """Keeps the feedback of a goal."""

    def __init__(self) -> None:
        self.payloads: list[bytes] = []

    def __call__(self, payload: bytes) -> None:
        self.payloads.append(payload)


async def send(place: Place, number: int = 3, feedback: Feedback | None = None) -> ClientGoal:
    """The robot sends a goal to the server's client."""
    client = await place.robot.create_action_client("/fib", FIBONACCI)
    assert await client.wait_available(PATIENCE_S)
    return await client.send_goal(Goal(order(number)), on_feedback=feedback)


def done(request: dict[str, Any], **more: Any) -> dict[str, Any]:
    """The result of a goal that succeeded."""
    values = {"sequence": [0, 1]}
    return {
        "op": "action_result",
        "action": request["action"],
        "id": request["id"],
        "values": values,
        "result": True,
        "status": 4,
        **more,
    }


@pytest.mark.parametrize("type", ["example_interfaces/Fibonacci", FIBONACCI])
async def test_carries_out(place: Place, type: str) -> None:
    """A goal goes to the client with numbered ids and the type as it gave it, its feedback and result go back."""
    provider = await offer(place, type=type)
    for number in (1, 2):
        feedback = Feedback()
        sent = asyncio.ensure_future(send(place, number, feedback))
        assert (await provider.receive()).data.decode() == (
            f'{{"op":"send_action_goal","id":"action_goal:/fib:{number}","action":"/fib","action_type":"{type}",'
            f'"args":{{"order":{number}}},"feedback":true}}'
        )
        id = f"action_goal:/fib:{number}"
        for values in ([0], [0, 1]):
            provider.send({"op": "action_feedback", "action": "/fib", "id": id, "values": {"sequence": values}})
        provider.send(done({"action": "/fib", "id": id}))
        outcome = await (await sent).result(PATIENCE_S)
        assert outcome == Outcome(GoalStatus.SUCCEEDED, sequence(0, 1))
        assert feedback.payloads == [sequence(0), sequence(0, 1)]
    await provider.nothing()
    assert place.complaints == {}


async def test_one_client_to_another(place: Place) -> None:
    """A client carries out the goals of another, under a relative name too."""
    provider = await offer(place, "fib")
    caller = await place.client()
    caller.send(goal(feedback=True))
    request = await provider.json()
    assert (request["id"], request["action"]) == ("action_goal:fib:1", "fib")
    feedback = {"op": "action_feedback", "action": "fib", "id": request["id"], "values": {"sequence": [1]}}
    provider.send(feedback)
    provider.send(done(request))
    assert (await caller.json())["values"] == {"sequence": [1]}
    assert await caller.json() == result(4, 0, 1)


@pytest.mark.parametrize(
    ("answer", "status", "values"),
    [
        ({"status": 4, "result": True, "values": {"sequence": [1]}}, 4, [1]),
        ({"status": 5, "result": True, "values": {"sequence": [1]}}, 6, [1]),
        ({"status": 6, "result": True, "values": {"sequence": [1]}}, 6, [1]),
        ({"status": 0, "result": True, "values": {"sequence": [1]}}, 6, [1]),
        ({"status": 99, "result": True, "values": {"sequence": [1]}}, 6, [1]),
        ({"result": True, "values": {"sequence": [1]}}, 4, [1]),
        ({"status": None, "result": True, "values": {"sequence": [1]}}, 4, [1]),
        ({"result": False, "values": {"sequence": [1]}}, 6, []),
        ({"status": 4, "result": False, "values": {"sequence": [1]}}, 6, []),
        ({"status": 4, "result": False, "values": "no"}, 6, []),
        ({"status": 4, "result": False}, 6, []),
        ({"status": 4, "result": True, "values": "no"}, 6, []),
        ({"status": 4, "result": True}, 4, []),
        ({"status": 4, "result": True, "values": {"sequence": "no"}}, 6, []),
        ({"status": 4, "values": {"sequence": [1]}}, 6, []),
        ({"status": "4", "result": True, "values": {"sequence": [1]}}, 6, []),
    ],
)
async def test_results(place: Place, answer: dict[str, Any], status: int, values: list[int]) -> None:
    """A result counts with its status; one without has 4 or 6, one that is no result aborts the goal at once."""
    provider = await offer(place)
    caller = await place.client()
    caller.send(goal())
    request = await provider.json()
    provider.send({"op": "action_result", "action": "/fib", "id": request["id"], **answer})
    assert await caller.json(2) == result(status, *values)


async def test_is_asked_to_cancel(place: Place) -> None:
    """A client is asked to end a goal once, and its result tells whether it did."""
    provider = await offer(place)
    caller = await place.client()
    caller.send(goal())
    request = await provider.json()
    caller.send({"op": "cancel_action_goal", "action": "/fib", "id": "g"})
    assert (await provider.receive()).data == (b'{"op":"cancel_action_goal","id":"action_goal:/fib:1","action":"/fib"}')
    provider.send(done(request, status=5))
    assert await caller.json() == result(5, 0, 1)
    await provider.nothing()


async def test_caller_leaves(place: Place) -> None:
    """A client is asked to end the goal of one that has left; its result then interests nobody."""
    provider = await offer(place)
    caller = await place.client()
    caller.send(goal())
    request = await provider.json()
    caller.abort()
    assert await provider.json() == {"op": "cancel_action_goal", "id": request["id"], "action": "/fib"}
    provider.send(done(request, status=5))
    await provider.nothing()


async def test_provider_leaves(place: Place) -> None:
    """The goals of a client that leaves are aborted, here and on the network, and the action is gone."""
    provider = await offer(place)
    caller = await place.client()
    caller.send(goal())
    sent = await send(place)
    assert [(await provider.json())["op"] for _ in range(2)] == ["send_action_goal"] * 2
    provider.abort()
    assert await caller.json(3) == result(6)
    assert (await sent.result(PATIENCE_S)).status == GoalStatus.ABORTED
    caller.send(goal("again"))
    assert (await caller.json())["values"] == "No action server available"
    other = await offer(place)
    caller.send(goal("new"))
    assert (await other.json())["id"] == "action_goal:/fib:1"


async def test_unadvertise(place: Place) -> None:
    """An action that is withdrawn aborts its goals and is gone; what was never there is counted."""
    provider = await offer(place)
    caller = await place.client()
    caller.send(goal())
    await provider.json()
    provider.send({"op": "unadvertise_action", "action": "/fib"})
    assert await caller.json(3) == result(6)
    caller.send(goal())
    assert (await caller.json())["values"] == "No action server available"
    provider.send({"op": "unadvertise_action", "action": "/fib"})
    await provider.nothing()
    assert place.complaints == {"unadvertise_action": 1}


async def test_advertised_twice(place: Place) -> None:
    """An action that its client advertises again begins anew: its goals are aborted, and ids count from one."""
    provider = await offer(place)
    caller = await place.client()
    caller.send(goal())
    await provider.json()
    provider.send({"op": "advertise_action", "action": "/fib", "type": FIBONACCI})
    assert await caller.json(3) == result(6)
    caller.send(goal())
    request = await provider.json()
    assert request["id"] == "action_goal:/fib:1"
    provider.send(done(request))
    assert await caller.json() == result(4, 0, 1)


async def test_two_providers(place: Place) -> None:
    """Of two clients that offer one action the first has it, and the second takes over when it leaves."""
    first = await offer(place)
    second = await place.client(path="/?status=1")
    second.send({"op": "advertise_action", "action": "/fib", "type": FIBONACCI})
    assert "Action /fib is already offered by" in (await second.json())["msg"]
    first.abort()
    assert (await second.json())["level"] == "info"
    caller = await place.client()
    caller.send(goal())
    assert (await second.json())["op"] == "send_action_goal"


async def test_strange_answers(place: Place) -> None:
    """Feedback and results that nobody waits for, or that are none, are counted and do no harm."""
    provider = await offer(place)
    caller = await place.client()
    caller.send(goal(feedback=True))
    request = await provider.json()
    feedback = {"op": "action_feedback", "action": "/fib", "id": request["id"], "values": {"sequence": [1]}}
    for bad in (
        {**feedback, "id": "other"},
        {**feedback, "action": "/other"},
        {**feedback, "values": {"x": 1}},
        {k: v for k, v in feedback.items() if k != "values"},
        {k: v for k, v in feedback.items() if k != "id"},
        done(request, id=7),
        done(request, action="/other"),
    ):
        provider.send(bad)
    provider.send(feedback)
    provider.send(done(request))
    provider.send(done(request))
    assert (await caller.json())["values"] == {"sequence": [1]}
    assert await caller.json() == result(4, 0, 1)
    await provider.nothing()
    await caller.nothing()
    assert place.complaints == {"action_feedback": 5, "action_result": 3}


@pytest.mark.parametrize(
    ("op", "kind"),
    [
        ('"action":"/s"', "operation"),
        ('"type":"example_interfaces/Fibonacci"', "operation"),
        ('"action":"/s","type":"example_interfaces/Unheard"', "advertise_action"),
        ('"action":"/s","type":"std_msgs/msg/String"', "advertise_action"),
        ('"action":"/s s","type":"example_interfaces/Fibonacci"', "advertise_action"),
    ],
)
async def test_bad_advertisements(place: Place, op: str, kind: str) -> None:
    """An action that cannot be served is counted and not offered."""
    client = await place.client()
    client.send('{"op":"advertise_action",' + op + "}")
    await client.nothing()
    assert place.complaints == {kind: 1}
    assert place.robot.actions() == {}


# ── the older kind of gateway ──────────────────────────────────────────────────────────────────────────────────────


async def test_rosgw_carries_out(place: Place) -> None:
    """A gateway of the older kind carries out goals: it gets them as it asked, names them besides, gives no status."""
    bridge = "0" * 31 + "1"
    provider = await offer(place, id=f"exposeact:{bridge}:1", compression="zip")
    caller = await place.client()
    caller.send(goal(feedback=True))
    got = await provider.receive()
    assert not got.text
    request = cbor2.loads(got.data)
    body = request.pop("args")
    assert request == {
        "op": "send_action_goal",
        "id": "action_goal:/fib:1",
        "action": "/fib",
        "action_type": "example_interfaces/Fibonacci",
        "feedback": True,
        "compression": "zip",
    }
    assert cbor2.loads(lz4.frame.decompress(body)) == {"order": 3}
    common = {"goal_id": "5" * 32, "action": "/fib", "result": True, "id": request["id"]}
    provider.send({"op": "action_feedback", **common, "values": {"sequence": [1]}})
    provider.send({"op": "action_result", **common, "values": {"sequence": [1, 2]}})
    assert (await caller.json())["values"] == {"sequence": [1]}
    assert await caller.json() == result(4, 1, 2)
    assert place.complaints == {}


async def test_rosgw_sends(place: Place) -> None:
    """A gateway of the older kind names the type otherwise, gets feedback unasked, and all in the encoding it named."""

    async def execute(goal: ServerGoal) -> Outcome:
        goal.feedback(sequence(1))
        return Outcome(GoalStatus.SUCCEEDED, sequence(ordered(goal)))

    await serve(place, execute)
    client = await place.client()
    common = {"op": "send_action_goal", "id": "act:" + "7" * 32, "action": "/fib", "compression": "zip"}
    client.send({**common, "type": FIBONACCI, "args": {"order": 2}})
    for op, values in (("action_feedback", [1]), ("action_result", [2])):
        got = await client.receive()
        assert not got.text
        answer = cbor2.loads(got.data)
        assert (answer["op"], answer["id"], answer["compression"]) == (op, "act:" + "7" * 32, "zip")
        assert cbor2.loads(lz4.frame.decompress(answer["values"]))["sequence"] == struct.pack("<i", *values)


async def test_rosgw_that_names_nothing(place: Place) -> None:
    """The id of its goals alone is a sign of a gateway of the older kind: it gets feedback, as text."""

    async def execute(goal: ServerGoal) -> Outcome:
        goal.feedback(sequence(1))
        return Outcome(GoalStatus.SUCCEEDED, sequence(2))

    await serve(place, execute)
    client = await place.client()
    client.send(goal("act:" + "8" * 32))
    assert (await client.json())["values"] == {"sequence": [1]}
    assert await client.json() == result(4, 2, id="act:" + "8" * 32)


async def test_rosbridge_client_asks_for_an_encoding(place: Place) -> None:
    """A client of rosbridge gets results in the binary encoding that it names, and no feedback unasked."""

    async def execute(goal: ServerGoal) -> Outcome:
        goal.feedback(sequence(1))
        return Outcome(GoalStatus.SUCCEEDED, sequence(2))

    await serve(place, execute)
    client = await place.client()
    client.send(goal(compression="cbor-raw"))
    got = await client.receive()
    answer = cbor2.loads(got.data)
    assert (answer["op"], answer["compression"], answer["values"]["bytes"]) == (
        "action_result",
        "cbor-raw",
        sequence(2),
    )


@pytest.mark.parametrize("cancels", [True, False])
async def test_server_stops(bare: Place, cancels: bool) -> None:
    """A goal that is under way when the server stops has an answer before the connection is closed."""
    await bare.start(cancel_goals=cancels)
    worker = Worker()
    await serve(bare, worker)
    client = await bare.client()
    client.send(goal())
    await until(lambda: worker.goals)
    stopping = asyncio.create_task(bare.server.close())
    answer = await client.json()
    assert (answer["op"], answer["id"]) == ("action_result", goal()["id"])
    assert answer["status"] == 5 or "the gateway stops" in answer["values"]
    assert (await client.closed())[0] == 1001
    await stopping
