"""The server's side of services and actions between two Ropeway gateways, message by message, bodies as text."""

from __future__ import annotations

import asyncio
from typing import Any

import pytest

from ropeway.errors import CallFailed, GoalRejected, NotServed
from ropeway.graph.begun import Begun, Ended
from ropeway.graph.calls import ActionHandlers, Goal, GoalStatus, Outcome, Request, ServerGoal
from ropeway.networks.rosbridge.protocol.dialect import ROPEWAY_SUBPROTOCOL
from tests.support.actions import FIBONACCI, Worker, count, order, sequence
from tests.support.place import Place
from tests.support.services import ADD, add, addends, total
from tests.support.until import PATIENCE_S, until
from tests.support.websocket import Client

pytestmark = pytest.mark.jumping

CALL = "0123456789abcdef" * 2


async def gateway(place: Place) -> Client:
    return await place.client(subprotocol=ROPEWAY_SUBPROTOCOL)


async def next_op(client: Client) -> Any:
    """The next message that is about services or actions."""
    while (got := await client.json())["op"] in ("hello", "ping", "pong", "stats"):
        pass
    return got


def call(service: str = "/add", **more: Any) -> dict[str, Any]:
    return {"op": "call_service", "service": service, "type": ADD, "id": "c", "args": {"a": 1}, **more}


def goal(id: str = "g", **more: Any) -> dict[str, Any]:
    return {
        "op": "send_action_goal",
        "action": "/fib",
        "action_type": FIBONACCI,
        "args": {"order": 1},
        "id": id,
        **more,
    }


async def test_call(place: Place) -> None:
    """A call keeps its number, its way and its caller; the answer is that of any call."""
    asked: list[Request] = []

    async def keep(request: Request) -> bytes:
        asked.append(request)
        return await add(request)

    await place.robot.create_service("/add", ADD, keep)
    client = await gateway(place)
    client.send(call(timeout=3, ropeway={"call": CALL, "via": ["one", "two"], "caller": "an operator"}))
    assert (await next_op(client))["values"] == {"sum": 1}
    (request,) = asked
    assert (request.id.hex(), request.via, request.caller) == (CALL, ("one", "two"), "an operator")


async def test_failures(place: Place) -> None:
    """A failure comes with a word that tells its kind."""

    async def fail(request: Request) -> bytes:
        raise CallFailed("/fails", "no hands")

    async def hang(request: Request) -> bytes:
        await asyncio.Event().wait()
        raise AssertionError

    await place.robot.create_service("/fails", ADD, fail)
    await place.robot.create_service("/hangs", ADD, hang)
    await place.robot.create_service("/other", "std_srvs/srv/Empty", hang)
    client = await gateway(place)
    for message, word in [
        (call("/nobody", timeout=0.2), "not_served"),
        (call("/fails"), "failed"),
        (call("/hangs", timeout=0.05), "timeout"),
        (call("/other"), "failed"),
        (call("/fails", args={"x": 1}), "failed"),
    ]:
        client.send(message)
        got = await next_op(client)
        assert (got["result"], got["ropeway"], got["id"]) == (False, {"error": word}, "c")
        assert isinstance(got["values"], str)


async def test_circle(bare: Place) -> None:
    """A call that passed this gateway before is refused."""
    await bare.start()
    bare.hub.calls.gateway_id = "me"
    await bare.robot.create_service("/add", ADD, add)
    client = await gateway(bare)
    client.send(call(ropeway={"call": CALL, "via": ["you", "me"]}))
    got = await next_op(client)
    assert got["result"] is False
    assert "circle" in got["values"]


async def test_serves(place: Place) -> None:
    """A gateway that serves is told number, way and caller of each call, and how long it may take."""
    provider = await gateway(place)
    provider.send({"op": "advertise_service", "service": "/add", "type": ADD, "id": "a"})
    await until(lambda: "/add" in place.robot.services())
    client = await place.robot.create_client("/add", ADD)
    request = Request(addends(1, 2), caller="somebody")
    answer = asyncio.ensure_future(client.call(request, 7))
    got = await next_op(provider)
    note = got.pop("ropeway")
    assert got.pop("timeout") == pytest.approx(7, abs=1)
    assert got == {
        "op": "call_service",
        "id": "service_request:/add:1",
        "service": "/add",
        "args": {"a": 1, "b": 2},
    }
    assert note["call"] == request.id.hex()
    response = {"op": "service_response", "service": "/add", "id": got["id"]}
    provider.send({**response, "values": {"sum": 3}, "result": True})
    assert await answer == total(3)
    answer = asyncio.ensure_future(client.call(Request(addends(1, 2)), 7))
    got = await next_op(provider)
    nobody = {"values": "Service /add does not exist", "result": False, "ropeway": {"error": "not_served"}}
    provider.send({**response, "id": got["id"], **nobody})
    with pytest.raises(NotServed):
        await answer


@pytest.mark.parametrize(("kind", "type"), [("service", ADD), ("action", FIBONACCI)])
async def test_two_providers(place: Place, kind: str, type: str) -> None:
    """The second of two gateways that offer a name is refused it with the first one's, and granted it afterwards."""
    first, second = await gateway(place), await gateway(place)
    offer = {"op": f"advertise_{kind}", kind: "/x", "type": type, "id": "a"}
    first.send(offer)
    await until(lambda: "/x" in (place.robot.services() if kind == "service" else place.robot.actions()))
    second.send(offer)
    refused = await next_op(second)
    assert (refused["op"], refused[kind]) == ("refused", "/x")
    assert refused["reason"] == f"{kind} /x is already offered by {refused['taken_by']}"
    assert refused["taken_by"].startswith("127.0.0.1:")
    first.abort()
    assert await next_op(second) == {"op": "granted", kind: "/x"}


@pytest.mark.parametrize(("kind", "type"), [("service", ADD), ("action", FIBONACCI)])
async def test_refused(place: Place, kind: str, type: str) -> None:
    """A gateway is told why it cannot offer something."""
    client = await gateway(place)
    client.send({"op": f"advertise_{kind}", kind: "/x x", "type": type, "id": "a"})
    got = await next_op(client)
    assert (got["op"], got[kind]) == ("refused", "/x x")
    assert "not a valid name" in got["reason"]


async def test_goal(place: Place) -> None:
    """A goal is accepted before anything else is said of it; the result is that of any goal."""
    await place.robot.create_action_server("/fib", FIBONACCI, ActionHandlers(count))
    client = await gateway(place)
    client.send(goal(feedback=True))
    assert await next_op(client) == {"op": "accepted", "id": "g"}
    got = [await next_op(client) for _ in range(2)]
    assert [(g["op"], g["id"]) for g in got] == [("action_feedback", "g"), ("action_result", "g")]
    assert (got[1]["status"], got[1]["result"], got[1]["values"]) == (4, True, {"sequence": [0]})


async def test_goals_that_fail(place: Place) -> None:
    """A rejected goal has the status 0 and a word; an aborted one without a result has its status and a text."""

    async def fail(goal: ServerGoal) -> Outcome:
        raise CallFailed("/fib", "no legs")

    async def accept(goal: ServerGoal) -> bool:
        return goal.payload == order(1)

    provider = place.hub.view("provider")
    await provider.create_action_server("/fib", FIBONACCI, ActionHandlers(fail, accept))
    client = await gateway(place)
    client.send(goal(args={"order": 2}))
    got = await next_op(client)
    assert (got["op"], got["status"], got["result"]) == ("action_result", 0, False)
    assert (got["values"], got["ropeway"]) == ("Action goal was rejected", {"error": "rejected"})
    client.send(goal())
    assert (await next_op(client))["op"] == "accepted"
    got = await next_op(client)
    assert (got["values"], got["status"], got["result"]) == ("no legs", 6, False)
    await provider.close()


async def test_cancel(place: Place) -> None:
    """A request to cancel is answered with whether the provider agrees."""
    worker = Worker()
    await place.robot.create_action_server("/fib", FIBONACCI, ActionHandlers(worker))
    client = await gateway(place)
    client.send({"op": "cancel_action_goal", "action": "/fib", "id": "unknown"})
    assert await next_op(client) == {"op": "cancelling", "id": "unknown", "agreed": False}
    client.send(goal())
    assert (await next_op(client))["op"] == "accepted"
    client.send({"op": "cancel_action_goal", "action": "/fib", "id": "g"})
    got = [await next_op(client) for _ in range(2)]
    assert {"op": "cancelling", "id": "g", "agreed": True} in got
    (result,) = [g for g in got if g["op"] == "action_result"]
    assert (result["status"], result["values"]) == (5, {"sequence": [5]})


async def test_carries_out(place: Place) -> None:
    """A gateway that carries out goals says whether it takes each, and whether it agrees to its end."""
    provider = await gateway(place)
    provider.send({"op": "advertise_action", "action": "/fib", "type": FIBONACCI, "id": "a"})
    await until(lambda: "/fib" in place.robot.actions())
    client = await place.robot.create_action_client("/fib", FIBONACCI)
    assert await client.wait_available(PATIENCE_S)
    sending = asyncio.ensure_future(client.send_goal(Goal(order(1))))
    asked = await next_op(provider)
    assert (asked["id"], asked["action_type"], asked["args"]) == ("action_goal:/fib:1", FIBONACCI, {"order": 1})
    rejected = {"op": "action_result", "action": "/fib", "status": 0, "result": False}
    provider.send({**rejected, "id": asked["id"], "values": "Action goal was rejected"})
    with pytest.raises(GoalRejected):
        await sending
    sending = asyncio.ensure_future(client.send_goal(Goal(order(2))))
    asked = await next_op(provider)
    assert not sending.done()
    provider.send({"op": "accepted", "id": asked["id"]})
    running = await sending
    for agreed in (False, True):
        cancelling = asyncio.ensure_future(running.cancel())
        assert await next_op(provider) == {"op": "cancel_action_goal", "id": asked["id"], "action": "/fib"}
        provider.send({"op": "cancelling", "id": asked["id"], "agreed": agreed})
        assert await cancelling is agreed
    values = {"sequence": [5]}
    provider.send(
        {"op": "action_result", "action": "/fib", "id": asked["id"], "values": values, "status": 5, "result": True}
    )
    assert await running.result(PATIENCE_S) == Outcome(GoalStatus.CANCELED, sequence(5))


async def test_provider_leaves_before_it_accepts(place: Place) -> None:
    """A goal that a gateway has not accepted fails at once when the gateway leaves."""
    provider = await gateway(place)
    provider.send({"op": "advertise_action", "action": "/fib", "type": FIBONACCI, "id": "a"})
    await until(lambda: "/fib" in place.robot.actions())
    caller = await place.client()
    caller.send({**goal(), "feedback": True})
    await next_op(provider)
    provider.abort()
    got = await caller.json(3)
    assert (got["op"], got["status"], got["result"]) == ("action_result", 0, False)


# ── calls that are begun without a task ────────────────────────────────────────────────────────────────────────────


class Beginner:
    """Stands in for the client of a graph that can begin calls at once; keeps those that it began."""

    def __init__(self) -> None:
        self.calls: list[Begun] = []
        self.full = False

    def begin(self, request: Request, timeout_s: float, ended: Ended) -> Begun | None:
        if self.full:
            return None
        self.calls.append(Begun(ended))
        return self.calls[-1]


async def begins(place: Place, client: Client) -> Beginner:
    """Have the client that is kept for a gateway's calls begin them at once."""
    await place.robot.create_service("/add", ADD, add)
    client.send(call())
    await next_op(client)
    beginner = Beginner()
    (kept,) = place.session.services._clients.kept.values()
    kept._begins = beginner.begin
    return beginner


async def test_begun_calls(place: Place) -> None:
    """A call that is begun at once is answered once, with what came of it; where there is no room, as ever."""
    client = await gateway(place)
    beginner = await begins(place, client)
    for how, result, values in (
        (total(7), True, {"sum": 7}),
        (CallFailed("/add", "no hands"), False, "no hands"),
        (ZeroDivisionError("boom"), False, "internal error"),
    ):
        client.send(call())
        await until(lambda: beginner.calls)
        assert not place.session.services._calls
        beginner.calls.pop().end(how)
        got = await next_op(client)
        assert (got["values"], got["result"], got["id"]) == (values, result, "c")
    beginner.full = True
    client.send(call())
    assert (await next_op(client))["values"] == {"sum": 1}
    assert not place.session.services._begun
    assert place.session.requests_bytes == 0


async def test_begun_calls_of_who_leaves(place: Place) -> None:
    """Calls that were begun at once are given up when the gateway leaves."""
    client = await gateway(place)
    beginner = await begins(place, client)
    for i in range(3):
        client.send(call(id=f"{i}"))
    await until(lambda: len(beginner.calls) == 3)
    client.abort()
    await until(lambda: all(each.over for each in beginner.calls))
