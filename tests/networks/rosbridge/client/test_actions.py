"""ropeway.networks.rosbridge.client.actions and servers: actions over a link, to plain servers and to gateways."""

from __future__ import annotations

import asyncio
import gc
from collections.abc import Callable
from contextlib import AsyncExitStack
from typing import Any

import cbor2
import lz4.frame
import pytest

from ropeway.errors import CallFailed, CallTimeout, GoalRejected, GraphUnavailable, NotServed, ProviderLost, UnknownType
from ropeway.graph.base import Delivery, Undelivered
from ropeway.graph.calls import ActionHandlers, ClientGoal, Goal, GoalStatus, Outcome, ServerGoal, new_id
from ropeway.networks.rosbridge.client import RosbridgeGraph, servers
from ropeway.networks.rosbridge.client.actions import RemoteActionClient
from ropeway.networks.rosbridge.protocol import ops
from ropeway.networks.rosbridge.protocol.codec import decode_value
from ropeway.networks.rosbridge.protocol.dialect import ROSGW
from tests.networks.rosbridge.client.gateways import ScriptedGateway
from tests.networks.rosbridge.client.test_services import connect, heard, played
from tests.support.actions import FIBONACCI, Worker, order, sequence
from tests.support.rosbridge import REGISTRY, Cloud, FakeServer
from tests.support.until import PATIENCE_S, until

pytestmark = pytest.mark.jumping

CODEC = REGISTRY.codec(f"{FIBONACCI}_Feedback")  # the result has the same field


async def ended(goal: ClientGoal) -> Outcome:
    return await goal.result(PATIENCE_S)


def say_result(fake: FakeServer, id: object, values: object, status: int | None, *, result: bool = True) -> None:
    message = {"op": "action_result", "action": "/fib", "values": values, "result": result, "id": id}
    fake.say(message if status is None else {**message, "status": status})


async def sent(
    client: RemoteActionClient, fake: FakeServer, on_feedback: Callable[[bytes], None] | None = None
) -> tuple[Any, dict[str, Any]]:
    """A goal at a plain server, and what the server got."""
    count = len(fake.ops("send_action_goal"))
    goal = await client.send_goal(Goal(order(5)), on_feedback=on_feedback)
    return goal, (await heard(fake, "send_action_goal", count + 1))[-1]


# ── using an action of a plain server ──────────────────────────────────────────────────────────────────────────────


async def test_goal_of_a_plain_server(stack: AsyncExitStack, fake: FakeServer) -> None:
    """A plain server gets a goal as rosbridge knows it; feedback and the result go to the goal with their id."""
    graph = await connect(stack, fake.url)
    client = await graph.create_action_client("/fib", "example_interfaces/Fibonacci")
    assert client.available is None
    assert await client.wait_available(0)
    fed: list[bytes] = []
    goal, message = await sent(client, fake, fed.append)
    assert message == {
        "op": "send_action_goal",
        "id": "send_action_goal:/fib:1",
        "action": "/fib",
        "action_type": FIBONACCI,
        "args": {"order": 5},
        "feedback": True,
    }
    other, message = await sent(client, fake)
    assert "feedback" not in message
    for id in ("send_action_goal:/fib:1", "send_action_goal:/fib:2"):
        fake.say({"op": "action_feedback", "action": "/fib", "values": {"sequence": [1]}, "id": id})
    say_result(fake, "send_action_goal:/fib:2", {"sequence": [2]}, 4)
    say_result(fake, "send_action_goal:/fib:1", {"sequence": [3]}, 6)
    assert await ended(other) == Outcome(GoalStatus.SUCCEEDED, sequence(2))
    assert await ended(goal) == Outcome(GoalStatus.ABORTED, sequence(3))
    assert fed == [sequence(1)]
    assert not await goal.cancel()
    assert not graph.calls.goals


@pytest.mark.parametrize(
    ("values", "status", "result", "outcome"),
    [
        ({"sequence": [1]}, 5, True, Outcome(GoalStatus.CANCELED, sequence(1))),
        ({"sequence": [1]}, None, True, Outcome(GoalStatus.SUCCEEDED, sequence(1))),  # as rosgw says it
        ({"sequence": [1]}, 0, True, Outcome(GoalStatus.ABORTED, sequence(1))),
        (None, 4, True, Outcome(GoalStatus.SUCCEEDED, sequence())),
        (
            "Action goal was rejected",
            0,
            False,
            Outcome(GoalStatus.ABORTED, None, "Action goal was rejected", rejected=True),
        ),
        ("No action server available", 0, False, Outcome(GoalStatus.ABORTED, None, "No action server available")),
        ("boom", 4, False, Outcome(GoalStatus.ABORTED, None, "boom")),
        ("enough", 5, False, Outcome(GoalStatus.CANCELED, None, "enough")),
        ({}, None, False, Outcome(GoalStatus.ABORTED, None, "/fib failed, and does not say why")),
    ],
)
async def test_results_of_a_plain_server(
    stack: AsyncExitStack, fake: FakeServer, values: object, status: int | None, result: bool, outcome: Outcome
) -> None:
    """Whatever a plain server says a goal ended with is one of the three outcomes."""
    graph = await connect(stack, fake.url)
    goal, message = await sent(await graph.create_action_client("/fib", FIBONACCI), fake)
    say_result(fake, message["id"], values, status, result=result)
    assert await ended(goal) == outcome


async def test_goal_of_rosgw(stack: AsyncExitStack, fake: FakeServer) -> None:
    """A rosgw server has named no encoding, so it gets goals as text; what it names in its answers is understood."""
    graph = await connect(stack, fake.url)
    assert graph.peer is not None
    graph.peer.speak(ROSGW)
    client = await graph.create_action_client("/fib", FIBONACCI, delivery=Delivery(encoding="zip"))
    assert client.encoding == "none"
    fed: list[bytes] = []
    goal, message = await sent(client, fake, fed.append)
    assert (message["args"], message.get("compression")) == ({"order": 5}, None)
    common = {"action": "/fib", "id": message["id"], "result": True, "compression": "zip"}
    for op, numbers in (("action_feedback", (1,)), ("action_result", (1, 2))):
        values = lz4.frame.compress(cbor2.dumps(CODEC.rosgw(sequence(*numbers))))
        fake.connections[-1].send_binary(cbor2.dumps({"op": op, **common, "values": values}))
    assert await ended(goal) == Outcome(GoalStatus.SUCCEEDED, sequence(1, 2))
    assert fed == [sequence(1)]


async def test_serves_on_rosgw(stack: AsyncExitStack, fake: FakeServer) -> None:
    """A rosgw server is told the configured encoding, gets feedback unasked, and all in the encoding of its goal."""
    graph = await connect(stack, fake.url)
    assert graph.peer is not None
    graph.peer.speak(ROSGW)

    async def execute(goal: ServerGoal) -> Outcome:
        goal.feedback(sequence(1))
        return Outcome(GoalStatus.SUCCEEDED, sequence(1, 2))

    server = await graph.create_action_server(
        "/fib", FIBONACCI, ActionHandlers(execute), delivery=Delivery(encoding="zip")
    )
    (told,) = await heard(fake, "advertise_action")
    assert told["compression"] == "zip"
    assert server.encoding == "none"  # nobody has asked for another yet
    common = {"op": "send_action_goal", "action": "/fib", "action_type": FIBONACCI, "args": {"order": 2}}
    fake.say({**common, "id": f"act:{'a' * 32}"})
    (feedback,) = await heard(fake, "action_feedback")
    assert (feedback["id"], feedback["values"]) == (f"act:{'a' * 32}", {"sequence": [1]})
    (result,) = await heard(fake, "action_result")
    assert (result["values"], result["result"]) == ({"sequence": [1, 2]}, True)
    args = lz4.frame.compress(cbor2.dumps({"order": 2}))
    fake.connections[-1].send_binary(cbor2.dumps({**common, "id": "2", "args": args, "compression": "zip"}))
    await until(lambda: len(fake.binaries) == 2)
    for raw, numbers in zip(fake.binaries, ((1,), (1, 2)), strict=True):
        answer = cbor2.loads(raw)
        assert (answer["id"], answer["compression"]) == ("2", "zip")
        assert decode_value(answer["values"], "zip", CODEC) == sequence(*numbers)
    assert server.encoding == "zip"


async def test_unreadable_feedback_and_result(stack: AsyncExitStack, fake: FakeServer) -> None:
    """Feedback that is not of the type, or whose callback fails, is counted; such a result aborts its goal."""
    graph = await connect(stack, fake.url)
    client = await graph.create_action_client("/fib", FIBONACCI)
    goal, message = await sent(client, fake, lambda _: [][0])
    for values in ({"sequence": "x"}, {"sequence": [1]}):
        fake.say({"op": "action_feedback", "action": "/fib", "values": values, "id": message["id"]})
    say_result(fake, message["id"], {"sequence": 1}, 4)
    outcome = await ended(goal)
    assert outcome.status is GoalStatus.ABORTED
    assert "sequence" in outcome.text
    assert graph.drops["/fib", Undelivered.DECODE] == graph.drops["/fib", Undelivered.CALLBACK] == 1
    fake.say({"op": "action_feedback", "action": "/fib", "values": {}, "id": message["id"]})
    say_result(fake, message["id"], {"sequence": 1}, 4)
    await until(lambda: graph.drops["/fib", Undelivered.LATE] == 2)


async def test_cancel_at_a_plain_server(stack: AsyncExitStack, fake: FakeServer) -> None:
    """A plain server does not say whether it agrees: to ask is all; rosgw, which knows no cancel, is not asked."""
    graph = await connect(stack, fake.url)
    client = await graph.create_action_client("/fib", FIBONACCI)
    goal, message = await sent(client, fake)
    assert await goal.cancel()
    (cancel,) = await heard(fake, "cancel_action_goal")
    assert cancel == {"op": "cancel_action_goal", "id": message["id"], "action": "/fib"}
    with pytest.raises(CallTimeout):
        await goal.result(0.05)
    assert graph.peer is not None
    graph.peer.speak(ROSGW)
    assert not await goal.cancel()
    say_result(fake, message["id"], {}, 5)
    assert (await ended(goal)).status is GoalStatus.CANCELED
    assert len(fake.ops("cancel_action_goal")) == 1


async def test_link_is_lost(stack: AsyncExitStack, fake: FakeServer) -> None:
    """Goals are aborted at once when the link goes; with the link down none can be sent."""
    graph = await connect(stack, fake.url)
    client = await graph.create_action_client("/fib", FIBONACCI)
    goal, _ = await sent(client, fake)
    await fake.stop()
    outcome = await ended(goal)
    assert outcome.status is GoalStatus.ABORTED
    assert "link" in outcome.text
    assert not await goal.cancel()
    with pytest.raises(GraphUnavailable, match="the link is down"):
        await client.send_goal(Goal(order(1)), timeout_s=0.1)


async def test_client_closes(stack: AsyncExitStack, fake: FakeServer) -> None:
    """A client that closes aborts the outcomes that are awaited, and sends no more; what comes late is counted."""
    graph = await connect(stack, fake.url)
    client = await graph.create_action_client("/fib", FIBONACCI)
    goal, message = await sent(client, fake)
    await client.close()
    await client.close()
    assert (await ended(goal)).text == "the client of /fib was closed"
    with pytest.raises(GraphUnavailable, match="closed"):
        await client.send_goal(Goal(order(1)))
    assert client.available is False
    say_result(fake, message["id"], {}, 4)
    await until(lambda: graph.drops["", Undelivered.LATE] == 1)
    assert graph.peer is not None
    assert not graph.peer.fault_log.counts


async def test_bad_feedback_of_ours(stack: AsyncExitStack, fake: FakeServer) -> None:
    """Feedback of ours that is not of the type is counted, and the goal goes on."""

    async def execute(goal: ServerGoal) -> Outcome:
        goal.feedback(b"\0\1\0\0")
        return Outcome(GoalStatus.SUCCEEDED, sequence(1))

    graph = await connect(stack, fake.url)
    await serve(graph, execute)
    ask(fake, feedback=True)
    assert (await heard(fake, "action_result"))[0]["status"] == 4
    assert graph.drops["/fib", Undelivered.ENCODE] == 1
    assert not fake.ops("action_feedback")


async def test_goal_of_an_unknown_type(stack: AsyncExitStack, fake: FakeServer) -> None:
    """A goal whose type nobody knows cannot be sent to a plain server, nor can its action be served there."""
    graph = await connect(stack, fake.url)
    client = await graph.create_action_client("/own", "my_msgs/action/Own")
    with pytest.raises(CallFailed, match="not known"):
        await client.send_goal(Goal(order(1)))
    with pytest.raises(UnknownType):
        await graph.create_action_server("/own", "my_msgs/action/Own", ActionHandlers(Worker()))
    assert not graph.actions()
    assert not graph.calls.goals


# ── serving an action on a plain server ────────────────────────────────────────────────────────────────────────────


async def serve(graph: RosbridgeGraph, execute: Any, delivery: Delivery | None = None, **handlers: Any) -> Any:
    made = ActionHandlers(execute, **handlers)
    return await graph.create_action_server("/fib", FIBONACCI, made, delivery=delivery or Delivery())


def ask(fake: FakeServer, id: object = "1", **fields: Any) -> None:
    goal = {"op": "send_action_goal", "action": "/fib", "action_type": FIBONACCI, "args": {"order": 3}, "id": id}
    fake.say({**goal, **fields})


async def test_serves_on_a_plain_server(stack: AsyncExitStack, fake: FakeServer) -> None:
    """An action is advertised, carries out goals by id with feedback where it is wanted, and is withdrawn."""

    async def execute(goal: ServerGoal) -> Outcome:
        goal.feedback(sequence(1))
        return Outcome(GoalStatus(4 if goal.payload == order(3) else 6), sequence(7))

    graph = await connect(stack, fake.url)
    server = await serve(graph, execute)
    (advertised,) = await heard(fake, "advertise_action")
    assert advertised == {"op": "advertise_action", "id": server.id, "action": "/fib", "type": FIBONACCI}
    ask(fake, feedback=True)
    assert await heard(fake, "action_feedback") == [
        {"op": "action_feedback", "action": "/fib", "values": {"sequence": [1]}, "id": "1"}
    ]
    assert await heard(fake, "action_result") == [
        {
            "op": "action_result",
            "action": "/fib",
            "values": {"sequence": [7]},
            "status": 4,
            "result": True,
            "id": "1",
        }
    ]
    ask(fake, None, args={"order": 2})
    (_, second) = await heard(fake, "action_result", 2)
    assert ("id" in second, second["status"]) == (False, 6)
    assert len(fake.ops("action_feedback")) == 1
    fake.say({"op": "send_action_goal", "action": "/none", "action_type": FIBONACCI, "id": 5})
    third = (await heard(fake, "action_result", 3))[-1]
    assert (third["values"], third["status"], third["result"]) == ("No action server available", 0, False)
    await server.close()
    await server.close()
    (withdrawn,) = await heard(fake, "unadvertise_action")
    assert withdrawn == {"op": "unadvertise_action", "id": server.id, "action": "/fib"}
    assert not fake.ops("accepted")


async def test_empty_ends(stack: AsyncExitStack, fake: FakeServer) -> None:
    """Without a result a plain server gets an empty one with the status, and rosgw a failure besides."""
    outcomes: list[Outcome | Exception] = [
        Outcome(GoalStatus.ABORTED, None, "tired"),
        Outcome(GoalStatus.CANCELED),
        CallFailed("/fib", "no"),
        KeyError("key"),
        Outcome(GoalStatus.SUCCEEDED, b"\0\1\0\0"),
        Outcome(GoalStatus.SUCCEEDED),
        Outcome(GoalStatus.CANCELED, sequence(1)),
    ]

    async def execute(goal: ServerGoal) -> Outcome:
        outcome = outcomes.pop(0)
        if isinstance(outcome, Exception):
            raise outcome
        return outcome

    graph = await connect(stack, fake.url)
    await serve(graph, execute)
    for number in range(7):
        if number == 5:
            assert graph.peer is not None
            graph.peer.speak(ROSGW)
        ask(fake, number)
        await heard(fake, "action_result", number + 1)
    got = [(m["status"], m["result"], m["values"]) for m in fake.ops("action_result")]
    assert got == [
        (6, True, {}),
        (5, True, {}),
        (6, True, {}),
        (6, True, {}),
        (6, True, {}),
        (4, True, {}),
        (5, False, {"sequence": [1]}),
    ]


async def test_bad_goals(stack: AsyncExitStack, fake: FakeServer, monkeypatch: pytest.MonkeyPatch) -> None:
    """A goal that is not of the type, is under way already, is one too many or is not accepted is aborted."""
    monkeypatch.setattr(servers, "CALLS_LIMIT", 2)
    worker = Worker()
    refused: list[ServerGoal] = []

    async def accept(goal: ServerGoal) -> bool:
        if len(worker.goals) < 2:
            return True
        refused.append(goal)
        return False

    graph = await connect(stack, fake.url)
    await serve(graph, worker, accept=accept)
    ask(fake, args={"order": "x"})
    await heard(fake, "action_result")
    for id in (1, 1, 2):
        ask(fake, id)
    await until(lambda: len(worker.goals) == 2)
    ask(fake, 3)
    await heard(fake, "action_result", 3)
    worker.finish.set()
    await heard(fake, "action_result", 5)
    ask(fake, 4)
    assert [m["status"] for m in await heard(fake, "action_result", 6)] == [6, 6, 6, 4, 4, 6]
    assert len(refused) == 1


@pytest.mark.parametrize("turns", range(4))
async def test_goal_that_fails_as_its_sender_leaves(stack: AsyncExitStack, far: ScriptedGateway, turns: int) -> None:
    """A goal that fails just as its sender is cancelled leaves no failure that nobody has seen."""
    unseen: list[dict[str, Any]] = []
    asyncio.get_running_loop().set_exception_handler(lambda _, context: unseen.append(context))
    graph = await played(stack, far)
    client = await graph.create_action_client("/fib", FIBONACCI)
    sender = asyncio.create_task(client.send_goal(Goal(order(3), new_id()), timeout_s=PATIENCE_S))
    await far.hear("send_action_goal")
    (goal,) = graph.calls.goals.values()
    goal.lost("the link to it was cut")
    for _ in range(turns):
        await asyncio.sleep(0)
    sender.cancel()
    await asyncio.wait({sender})
    assert sender.cancelled() or sender.exception() is not None
    del sender
    gc.collect()
    assert unseen == []


async def test_cancelled_by_a_plain_server(stack: AsyncExitStack, fake: FakeServer) -> None:
    """A goal whose end is asked for is cancelled, unless its handler disagrees, or fails."""
    worker = Worker()
    answers: list[Any] = [False, KeyError("key"), CallFailed("/fib", "no"), True]

    async def cancel(goal: ServerGoal) -> bool:
        answer = answers.pop(0)
        if isinstance(answer, Exception):
            raise answer
        return bool(answer)

    graph = await connect(stack, fake.url)
    await serve(graph, worker, cancel=cancel)
    ask(fake)
    for count in range(4):
        fake.say({"op": "cancel_action_goal", "action": "/fib", "id": "1"})
        await until(lambda count=count: len(answers) == 3 - count)
    for action in ("/fib", "/none"):
        fake.say({"op": "cancel_action_goal", "action": action, "id": "unknown"})
    (result,) = await heard(fake, "action_result")
    assert result["status"] == 5
    assert not fake.ops("cancelling")


async def test_server_closes(stack: AsyncExitStack, fake: FakeServer) -> None:
    """A server that closes aborts its goals; one that loses the link gives them up and is there again with it."""
    worker = Worker()
    graph = await connect(stack, fake.url)
    server = await serve(graph, worker)
    ask(fake, "lost")
    await until(lambda: worker.goals)
    fake.connections[-1].abort("gone")
    await heard(fake, "advertise_action", 2)
    ask(fake, "left")
    await until(lambda: len(worker.goals) == 2)
    await server.close()
    (result,) = await heard(fake, "action_result")
    assert (result["id"], result["status"]) == ("left", 6)


# ── gateways ───────────────────────────────────────────────────────────────────────────────────────────────────────


async def test_goal_of_a_gateway(stack: AsyncExitStack, far: ScriptedGateway) -> None:
    """A gateway is told the goal's own id and its way, says that it takes it, and answers a cancel."""
    graph = await played(stack, far)
    client = await graph.create_action_client("/fib", FIBONACCI, delivery=Delivery(encoding="zip"))
    id, fed = new_id(), list[bytes]()
    sending = asyncio.create_task(client.send_goal(Goal(order(5), id, ("a",), "/n"), on_feedback=fed.append))
    (op,) = await far.hear("send_action_goal")
    assert op.ropeway == {"call": id.hex(), "via": ["a", "us"], "caller": "/n", "encoding": "zip"}
    assert (op.compression, op.feedback) == ("zip", True)
    assert not sending.done()
    far.peer.send_op({"op": "accepted", "id": op.id})
    goal = await sending
    assert goal.id == id
    feedback = ops.ActionFeedback(id=op.id, action="/fib", values=None)
    far.peer.send_op(feedback, payload=sequence(1), field="values")
    refused = asyncio.create_task(goal.cancel(5))
    await far.hear("cancel_action_goal")
    far.peer.send_op({"op": "cancelling", "id": op.id, "agreed": False})
    assert not await refused
    agreed = [asyncio.create_task(goal.cancel(5)) for _ in range(2)]
    await far.hear("cancel_action_goal", 3)
    far.peer.send_op({"op": "cancelling", "id": op.id, "agreed": True})
    assert await asyncio.gather(*agreed) == [True, True]
    with pytest.raises(CallTimeout):
        await goal.cancel(0.05)
    last = asyncio.create_task(goal.cancel(5))
    await far.hear("cancel_action_goal", 5)
    result = ops.ActionResult(id=op.id, action="/fib", values=None, status=5, result=True)
    far.peer.send_op(result, payload=sequence(9), field="values", encoding="rawzip")
    assert await last
    assert await ended(goal) == Outcome(GoalStatus.CANCELED, sequence(9))
    assert fed == [sequence(1)]


@pytest.mark.parametrize(
    ("word", "text", "error"),
    [
        ("rejected", "no", GoalRejected),
        ("timeout", "late", CallTimeout),
        ("lost", "gone", ProviderLost),
        ("denied", "not allowed", CallFailed),
        (None, "Action goal was rejected", GoalRejected),
        (None, "boom", CallFailed),
    ],
)
async def test_gateway_does_not_take_it(
    stack: AsyncExitStack, far: ScriptedGateway, word: str | None, text: str, error: type[Exception]
) -> None:
    """A goal that a gateway does not take is an error of the kind that it names."""
    graph = await played(stack, far)
    client = await graph.create_action_client("/fib", FIBONACCI)
    sending = asyncio.create_task(client.send_goal(Goal(order(5))))
    (op,) = await far.hear("send_action_goal")
    note = {"error": word} if word else None
    far.peer.send_op(ops.ActionResult(id=op.id, action="/fib", values=text, status=0, result=False, ropeway=note))
    with pytest.raises(error):
        await sending
    assert not graph.calls.goals


async def test_not_served_by_a_gateway(stack: AsyncExitStack, far: ScriptedGateway) -> None:
    """A goal that nobody serves is tried again, and then not served."""
    graph = await played(stack, far)
    client = await graph.create_action_client("/fib", FIBONACCI)
    sending = asyncio.create_task(client.send_goal(Goal(order(5)), timeout_s=0.4))
    note = {"error": "not_served"}
    for count in (1, 2):
        op = (await far.hear("send_action_goal", count))[-1]
        far.peer.send_op(ops.ActionResult(id=op.id, action="/fib", values="", status=0, result=False, ropeway=note))
    with pytest.raises(NotServed, match="No action server available"):
        await sending


async def test_no_acceptance(stack: AsyncExitStack, far: ScriptedGateway) -> None:
    """A goal of which nobody says that it is taken is cancelled when its sender gives up, or the link goes."""
    graph = await played(stack, far)
    client = await graph.create_action_client("/fib", FIBONACCI)
    with pytest.raises(CallTimeout):
        await client.send_goal(Goal(order(5)), timeout_s=0.1)
    (cancel,) = await far.hear("cancel_action_goal")
    assert cancel.id == (await far.hear("send_action_goal"))[0].id
    leaving = asyncio.create_task(client.send_goal(Goal(order(5))))
    await far.hear("send_action_goal", 2)
    leaving.cancel()
    with pytest.raises(asyncio.CancelledError):
        await leaving
    await far.hear("cancel_action_goal", 2)
    lost = asyncio.create_task(client.send_goal(Goal(order(5))))
    await far.hear("send_action_goal", 3)
    far.peer.connection.abort("gone")
    with pytest.raises(ProviderLost):
        await lost
    closing = asyncio.create_task(client.send_goal(Goal(order(5))))
    await far.hear("send_action_goal", 4)
    await client.close()
    with pytest.raises(GraphUnavailable, match="closed"):
        await closing


async def test_serves_on_a_gateway(stack: AsyncExitStack, far: ScriptedGateway) -> None:
    """A gateway is told that a goal is taken, or why not, before anything else, and whether it will end."""
    worker = Worker()

    async def accept(goal: ServerGoal) -> bool:
        return goal.payload != order(0)

    async def execute(goal: ServerGoal) -> Outcome:
        goal.feedback(sequence(1))
        return await worker(goal)

    graph = await played(stack, far)
    await serve(graph, execute, Delivery(encoding="cbor"), accept=accept)
    (advertised,) = await far.hear("advertise_action")
    assert advertised.compression == "cbor"
    assert "int32 order" in advertised.ropeway["definition"]

    def send(id: str, number: int, call: str) -> None:
        note = {"call": call * 32, "via": ["them"], "caller": "x"}
        op = ops.SendActionGoal(id=id, action="/fib", action_type=FIBONACCI, args=None, feedback=True, ropeway=note)
        far.peer.send_op(op, payload=order(number))

    send("1", 0, "a")
    (rejected,) = await far.hear("action_result")
    assert (rejected.id, rejected.status, rejected.result) == ("1", 0, False)
    assert rejected.ropeway == {"error": "rejected"}
    send("2", 3, "b")
    assert (await far.hear_control("accepted"))[0]["id"] == "2"
    (feedback,) = await far.hear("action_feedback")
    assert (feedback.id, feedback.compression) == ("2", "cbor")
    (goal,) = worker.goals
    assert (goal.id, goal.via, goal.caller, goal.payload) == (b"\xbb" * 16, ("them",), "x", order(3))
    send("3", 3, "b")
    assert (await far.hear("action_result", 2))[-1].ropeway == {"error": "rejected"}
    for id in ("2", "3"):
        far.peer.send_op(ops.CancelActionGoal(id=id, action="/fib"))
    far.peer.send_op(ops.CancelActionGoal(id="4", action="/none"))
    answers = await far.hear_control("cancelling", 3)
    assert {a["id"]: a["agreed"] for a in answers} == {"2": True, "3": False, "4": False}
    result = (await far.hear("action_result", 3))[-1]
    assert (result.id, result.status, result.result, result.compression) == ("2", 5, True, "cbor")


async def test_empty_end_at_a_gateway(stack: AsyncExitStack, far: ScriptedGateway) -> None:
    """A gateway learns why a goal ended without a result."""

    async def execute(goal: ServerGoal) -> Outcome:
        return Outcome(GoalStatus.CANCELED, None, "tired")

    graph = await played(stack, far)
    server = await serve(graph, execute)
    await far.hear("advertise_action")
    op = ops.SendActionGoal(id="1", action="/fib", action_type=FIBONACCI, args=None)
    far.peer.send_op(op, payload=order(1))
    (result,) = await far.hear("action_result")
    assert (result.status, result.result, result.values) == (5, False, "tired")
    far.peer.send({"op": "refused", "action": "/fib", "reason": "robot1 has it"})
    await until(lambda: server.refused == "robot1 has it")
    far.peer.send({"op": "granted", "action": "/fib"})
    await until(lambda: not server.refused)


# ── a real server ──────────────────────────────────────────────────────────────────────────────────────────────────


@pytest.mark.parametrize("plain", [False, True])
@pytest.mark.parametrize("encoding", ["auto", "none", "cbor", "cbor-raw", "zip", "rawzip", "zstd", "png"])
async def test_through_a_server(stack: AsyncExitStack, cloud: Cloud, encoding: str, plain: bool) -> None:
    """Goals, feedback and results come through a server in every encoding, in order, byte for byte."""
    url = f"ws://127.0.0.1:{cloud.port}"
    near, far = await connect(stack, url, plain=plain), await connect(stack, url, gateway_id="them", plain=plain)
    long = sequence(*range(500_000))

    async def execute(goal: ServerGoal) -> Outcome:
        assert goal.payload == order(5)
        for number in range(3):
            goal.feedback(sequence(number))
        goal.feedback(long)
        return Outcome(GoalStatus.SUCCEEDED, sequence(8))

    delivery = Delivery(encoding=encoding)
    await serve(far, execute, delivery)
    client = await near.create_action_client("/fib", FIBONACCI, delivery=delivery)
    assert await client.wait_available(PATIENCE_S)
    fed: list[bytes] = []
    goal = await client.send_goal(Goal(order(5)), on_feedback=fed.append)
    assert await ended(goal) == Outcome(GoalStatus.SUCCEEDED, sequence(8))
    assert fed == [sequence(0), sequence(1), sequence(2), long]


async def test_sender_leaves(stack: AsyncExitStack, cloud: Cloud) -> None:
    """When the one who sent a goal leaves, the far server cancels it where it is carried out."""
    url = f"ws://127.0.0.1:{cloud.port}"
    near, far = await connect(stack, url), await connect(stack, url, gateway_id="them")
    worker = Worker()
    await serve(far, worker)
    client = await near.create_action_client("/fib", FIBONACCI)
    goal = await client.send_goal(Goal(order(5)))
    await until(lambda: worker.goals)
    assert near.peer is not None
    near.peer.connection.abort("gone")
    assert (await ended(goal)).status is GoalStatus.ABORTED
    await until(worker.goals[0].cancelled.is_set)
