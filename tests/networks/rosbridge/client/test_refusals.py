"""Operations of a server that cannot be understood, and whom they answer or fail."""

from __future__ import annotations

import asyncio
from contextlib import AsyncExitStack
from typing import Any

import pytest

from ropeway.errors import CallFailed
from ropeway.graph.calls import ActionHandlers, Goal, GoalStatus, Outcome, Request, ServerGoal
from ropeway.networks.rosbridge.client import RosbridgeGraph
from tests.support.actions import FIBONACCI, order
from tests.support.rosbridge import REGISTRY, FakeServer
from tests.support.services import ADD, add, addends
from tests.support.until import until

BAD = "\\ud800"  # half a surrogate pair, which is no text


@pytest.fixture
async def graph(stack: AsyncExitStack, fake: FakeServer) -> RosbridgeGraph:
    """A client of a server that the test plays."""
    made = RosbridgeGraph(fake.url, registry=REGISTRY, ask_rosapi=False, watch=False)
    await made.open()
    stack.push_async_callback(made.close)
    return made


def say(fake: FakeServer, text: str) -> None:
    """Send JSON that no library would write."""
    fake.connections[-1].send_text(text.encode())


async def answer(fake: FakeServer, op: str) -> dict[str, Any]:
    await until(lambda: bool(fake.ops(op)))
    return fake.ops(op)[-1]


async def test_a_call_that_cannot_be_read_is_answered(graph: RosbridgeGraph, fake: FakeServer) -> None:
    """A call of our service that is no text throughout fails under its id, with the reason, and its next one works."""
    await graph.create_service("/sum", ADD, add)
    await answer(fake, "advertise_service")
    say(fake, f'{{"op": "call_service", "service": "/sum", "id": "c1", "args": {{"{BAD}": 1}}}}')
    told = await answer(fake, "service_response")
    assert (told["id"], told["service"], told["result"]) == ("c1", "/sum", False)
    assert isinstance(told["values"], str)
    fake.say({"op": "call_service", "service": "/sum", "id": "c2", "args": {"a": 1, "b": 2}})
    await until(lambda: fake.ops("service_response")[-1]["id"] == "c2")
    assert fake.ops("service_response")[-1]["values"] == {"sum": 3}


async def test_a_goal_that_cannot_be_read_is_answered(graph: RosbridgeGraph, fake: FakeServer) -> None:
    """A goal for our action that is no text throughout is aborted under its id."""

    async def execute(goal: ServerGoal) -> Outcome:
        raise AssertionError

    await graph.create_action_server("/fib", FIBONACCI, ActionHandlers(execute))
    await answer(fake, "advertise_action")
    say(fake, f'{{"op": "send_action_goal", "action": "/fib", "id": "g1", "args": {{"order": "{BAD}"}}}}')
    told = await answer(fake, "action_result")
    assert (told["id"], told["action"], told["result"], told["status"]) == ("g1", "/fib", False, 6)


async def test_a_response_that_cannot_be_read_fails_its_call(graph: RosbridgeGraph, fake: FakeServer) -> None:
    """Who waits for such a response learns it at once."""
    client = await graph.create_client("/sum", ADD)
    calling = asyncio.create_task(client.call(Request(addends(1, 2)), 60))
    asked = await answer(fake, "call_service")
    say(fake, f'{{"op": "service_response", "service": "/sum", "id": "{asked["id"]}", "values": {{"{BAD}": 1}}}}')
    with pytest.raises(CallFailed):
        await calling


async def test_a_result_that_cannot_be_read_ends_its_goal(graph: RosbridgeGraph, fake: FakeServer) -> None:
    """A goal whose result is no text throughout is aborted, with the reason."""
    client = await graph.create_action_client("/fib", FIBONACCI)
    goal = await client.send_goal(Goal(order(3)))
    asked = await answer(fake, "send_action_goal")
    say(fake, f'{{"op": "action_result", "action": "/fib", "id": "{asked["id"]}", "values": {{"{BAD}": 1}}}}')
    outcome = await goal.result(60)
    assert outcome.status is GoalStatus.ABORTED
    assert outcome.text


@pytest.mark.parametrize(
    "text",
    [
        f'{{"op": "call_service", "service": "/sum", "args": {{"{BAD}": 1}}}}',
        f'{{"op": "call_service", "id": "c1", "args": {{"{BAD}": 1}}}}',
        f'{{"op": "publish", "topic": "/x", "id": "p1", "msg": {{"{BAD}": 1}}}}',
        f'{{"op": "service_response", "service": "/sum", "id": "nobody", "values": "{BAD}"}}',
        f'{{"op": "action_result", "action": "/fib", "id": "nobody", "values": "{BAD}"}}',
        f'{{"{BAD}": 1}}',
    ],
)
async def test_what_names_no_request_is_passed_over(graph: RosbridgeGraph, fake: FakeServer, text: str) -> None:
    """Without an id, a name, or anybody who waits there is nobody to answer, and the connection goes on."""
    await graph.create_service("/sum", ADD, add)
    await answer(fake, "advertise_service")
    say(fake, text)
    fake.say({"op": "call_service", "service": "/sum", "id": "after", "args": {"a": 1, "b": 2}})
    assert (await answer(fake, "service_response"))["id"] == "after"
    assert len(fake.ops("service_response")) == 1
    assert len(fake.connections) == 1
