"""ropeway.bridge.offer, service and action: one name on two graphs."""

from __future__ import annotations

import asyncio
import itertools
from collections.abc import AsyncIterator
from contextlib import AsyncExitStack
from typing import Any

import pytest

from ropeway import aio
from ropeway.bridge.action import ActionBridge
from ropeway.bridge.options import BridgeOptions
from ropeway.bridge.service import ServiceBridge
from ropeway.errors import CallFailed, CallTimeout, GoalRejected, NotServed
from ropeway.graph.calls import ActionHandlers, Goal, GoalStatus, Outcome, Request, ServerGoal
from ropeway.networks.memory.graph import MemoryGraph
from tests.support.actions import FIBONACCI
from tests.support.until import PATIENCE_S, until

pytestmark = pytest.mark.jumping

_numbers = itertools.count()
TRIGGER = "std_srvs/srv/Trigger"
EMPTY = b"\0\1\0\0"
ORDER = EMPTY + b"\5\0\0\0"
SEQUENCE = EMPTY + b"\2\0\0\0\0\0\0\0\1\0\0\0"


class Sides:
    """Two networks; the bridge has a participant on each, and so has a robot."""

    def __init__(self, stack: AsyncExitStack) -> None:
        self.stack = stack
        number = next(_numbers)
        self.near, self.far = f"offer-near-{number}", f"offer-far-{number}"

    async def participant(self, network: str, node: str) -> MemoryGraph:
        graph = MemoryGraph(network, node=node)
        await graph.open()
        self.stack.push_async_callback(graph.close)
        return graph

    async def open(self) -> None:
        self.source = await self.participant(self.near, "/gateway")
        self.target = await self.participant(self.far, "/gateway")
        self.server = await self.participant(self.near, "/server")
        self.caller = await self.participant(self.far, "/caller")

    def served(self) -> bool:
        """True if somebody serves /t, for all that the caller can see."""
        info = self.caller.services().get("/t")
        return info is not None and bool(info.servers)

    async def service(self, timeout_s: float | None = None) -> ServiceBridge:
        bridge = ServiceBridge(self.source, self.target, "/s", "/t", TRIGGER, BridgeOptions(timeout_s=timeout_s))
        await bridge.start()
        self.stack.push_async_callback(bridge.close)
        return bridge

    async def action(self, timeout_s: float | None = None) -> ActionBridge:
        bridge = ActionBridge(self.source, self.target, "/s", "/t", FIBONACCI, BridgeOptions(timeout_s=timeout_s))
        await bridge.start()
        self.stack.push_async_callback(bridge.close)
        return bridge


@pytest.fixture
async def sides() -> AsyncIterator[Sides]:
    """Two networks without a bridge yet."""
    async with AsyncExitStack() as stack:
        made = Sides(stack)
        await made.open()
        yield made


async def echo(request: Request) -> bytes:
    return EMPTY + b"echo " + request.payload[4:]


async def test_calls_pass(sides: Sides) -> None:
    """A call on the target is answered by the provider on the source, and counted."""
    await sides.server.create_service("/s", TRIGGER, echo)
    bridge = await sides.service()
    client = await sides.caller.create_client("/t", TRIGGER)
    assert await client.wait_available(PATIENCE_S)
    answers = await asyncio.gather(*(client.call(Request(EMPTY + bytes([i]))) for i in range(20)))
    assert answers == [EMPTY + b"echo " + bytes([i]) for i in range(20)]
    assert bridge.counts == {"answered": 20}
    assert bridge.state == "active"


async def test_offered_while_served(sides: Sides) -> None:
    """The name is on the target while somebody serves it on the source."""
    bridge = await sides.service()
    await until(lambda: bridge.state == "waiting")
    assert not sides.served()
    service = await sides.server.create_service("/s", TRIGGER, echo)
    await until(sides.served)
    await service.close()
    await until(lambda: not sides.served())


async def test_a_graph_that_fails_unforeseen(sides: Sides, monkeypatch: pytest.MonkeyPatch) -> None:
    """An exception that no graph should raise is shown as the state of the bridge, which is tried again."""
    create = sides.source.create_client
    broken = True

    async def fail(*args: Any, **more: Any) -> Any:
        if broken:
            raise RuntimeError("a library failed")
        return await create(*args, **more)

    monkeypatch.setattr(sides.source, "create_client", fail)
    bridge = await sides.service()
    await until(lambda: bridge.state == "failed")
    assert bridge.error == "RuntimeError: a library failed"
    broken = False
    await sides.server.create_service("/s", TRIGGER, echo)
    await until(sides.served)
    assert bridge.state == "active"


async def test_errors_pass(sides: Sides) -> None:
    """What the provider says against a request reaches the caller."""

    async def refuse(request: Request) -> bytes:
        raise CallFailed("/s", "the gripper is hot")

    await sides.server.create_service("/s", TRIGGER, refuse)
    bridge = await sides.service()
    client = await sides.caller.create_client("/t", TRIGGER)
    assert await client.wait_available(PATIENCE_S)
    with pytest.raises(CallFailed, match="the gripper is hot"):
        await client.call(Request(EMPTY))
    assert bridge.counts == {"CallFailed": 1}


async def test_time_of_a_route(sides: Sides) -> None:
    """A call takes no longer than the route allows, though the caller would wait."""

    async def never(request: Request) -> bytes:
        await asyncio.Event().wait()
        return b""

    await sides.server.create_service("/s", TRIGGER, never)
    bridge = await sides.service(timeout_s=0.05)
    client = await sides.caller.create_client("/t", TRIGGER)
    assert await client.wait_available(PATIENCE_S)
    with pytest.raises(CallTimeout):
        await client.call(Request(EMPTY), 30)
    assert bridge.counts == {"CallTimeout": 1}


async def test_provider_vanishes(sides: Sides) -> None:
    """A provider that leaves in mid-call fails the call at once, and later ones find nobody."""
    started = asyncio.Event()

    async def never(request: Request) -> bytes:
        started.set()
        await asyncio.Event().wait()
        return b""

    service = await sides.server.create_service("/s", TRIGGER, never)
    await sides.service()
    client = await sides.caller.create_client("/t", TRIGGER)
    assert await client.wait_available(PATIENCE_S)
    async with aio.TaskGroup() as group:
        call = group.create_task(_failure(client.call(Request(EMPTY), 30)))
        await started.wait()
        await service.close()
    assert "ProviderLost" in call.result() or "CallFailed" in call.result()
    await until(lambda: not sides.served())
    with pytest.raises(NotServed):
        await client.call(Request(EMPTY), 0.05)


async def _failure(call: object) -> str:
    try:
        await call
    except Exception as error:
        return f"{type(error).__name__}: {error}"
    return ""


async def test_goals_pass(sides: Sides) -> None:
    """A goal on the target runs on the source: accepted, with feedback, its result, and its status."""

    async def execute(goal: ServerGoal) -> Outcome:
        goal.feedback(SEQUENCE)
        return Outcome(GoalStatus.SUCCEEDED, SEQUENCE)

    await sides.server.create_action_server("/s", FIBONACCI, ActionHandlers(execute))
    bridge = await sides.action()
    client = await sides.caller.create_action_client("/t", FIBONACCI)
    assert await client.wait_available(PATIENCE_S)
    feedback: list[bytes] = []
    goal = await client.send_goal(Goal(ORDER), on_feedback=feedback.append)
    assert await goal.result(PATIENCE_S) == Outcome(GoalStatus.SUCCEEDED, SEQUENCE)
    await until(lambda: feedback)
    assert feedback == [SEQUENCE]
    assert bridge.counts == {"succeeded": 1}


async def test_goal_is_rejected(sides: Sides) -> None:
    """A goal that the provider rejects is rejected on the target."""

    async def execute(goal: ServerGoal) -> Outcome:
        raise AssertionError

    async def accept(goal: ServerGoal) -> bool:
        return False

    await sides.server.create_action_server("/s", FIBONACCI, ActionHandlers(execute, accept))
    await sides.action()
    client = await sides.caller.create_action_client("/t", FIBONACCI)
    assert await client.wait_available(PATIENCE_S)
    with pytest.raises(GoalRejected):
        await client.send_goal(Goal(ORDER))


async def _until_cancelled(goal: ServerGoal) -> Outcome:
    await goal.cancelled.wait()
    return Outcome(GoalStatus.CANCELED, SEQUENCE)


async def test_goal_is_cancelled(sides: Sides) -> None:
    """A cancel on the target reaches the provider, and the goal ends as canceled with its result."""
    await sides.server.create_action_server("/s", FIBONACCI, ActionHandlers(_until_cancelled))
    await sides.action()
    client = await sides.caller.create_action_client("/t", FIBONACCI)
    assert await client.wait_available(PATIENCE_S)
    goal = await client.send_goal(Goal(ORDER))
    assert await goal.cancel()
    assert await goal.result(PATIENCE_S) == Outcome(GoalStatus.CANCELED, SEQUENCE)


async def test_goal_takes_too_long(sides: Sides) -> None:
    """A goal beyond the time of its route is cancelled at the provider and aborted for the caller."""
    cancelled = asyncio.Event()

    async def execute(goal: ServerGoal) -> Outcome:
        await goal.cancelled.wait()
        cancelled.set()
        return Outcome(GoalStatus.CANCELED, SEQUENCE)

    await sides.server.create_action_server("/s", FIBONACCI, ActionHandlers(execute))
    await sides.action(timeout_s=0.05)
    client = await sides.caller.create_action_client("/t", FIBONACCI)
    assert await client.wait_available(PATIENCE_S)
    goal = await client.send_goal(Goal(ORDER))
    assert (await goal.result(PATIENCE_S)).status is GoalStatus.ABORTED
    await asyncio.wait_for(cancelled.wait(), PATIENCE_S)


async def test_bridge_closes_in_mid_goal(sides: Sides) -> None:
    """A bridge that closes aborts the goal for the caller and cancels it at the provider."""
    cancelled = asyncio.Event()

    async def execute(goal: ServerGoal) -> Outcome:
        await goal.cancelled.wait()
        cancelled.set()
        return Outcome(GoalStatus.CANCELED, SEQUENCE)

    await sides.server.create_action_server("/s", FIBONACCI, ActionHandlers(execute))
    bridge = await sides.action()
    client = await sides.caller.create_action_client("/t", FIBONACCI)
    assert await client.wait_available(PATIENCE_S)
    goal = await client.send_goal(Goal(ORDER))
    await bridge.close()
    assert (await goal.result(PATIENCE_S)).status is GoalStatus.ABORTED
    await asyncio.wait_for(cancelled.wait(), PATIENCE_S)
