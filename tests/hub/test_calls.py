"""ropeway.hub.calls, hub_actions and holders: one name, one provider, and calls between users of one graph."""

from __future__ import annotations

import asyncio
from collections.abc import AsyncIterator
from contextlib import AsyncExitStack
from dataclasses import replace

import pytest

from ropeway import aio
from ropeway.errors import CallFailed, CallTimeout, NotServed, ProviderLost
from ropeway.graph.calls import (
    ActionHandlers,
    Goal,
    GoalStatus,
    Outcome,
    ProviderInfo,
    Request,
    ServerGoal,
    ServiceInfo,
)
from ropeway.hub.hub import Hub
from ropeway.hub.ownership import Claim, NameOwners
from ropeway.networks.memory.graph import MemoryGraph
from tests.support.actions import FIBONACCI
from tests.support.until import PATIENCE_S, until

from .test_hub import Place

pytestmark = pytest.mark.jumping

TRIGGER = "std_srvs/srv/Trigger"
EMPTY = b"\0\1\0\0"


@pytest.fixture
async def place() -> AsyncIterator[Place]:
    """A hub whose network has a robot."""
    async with AsyncExitStack() as stack:
        made = Place(stack)
        await made.open()
        yield made


def says(text: bytes) -> object:
    async def handler(request: Request) -> bytes:
        return EMPTY + text + request.payload[4:]

    return handler


async def call(graph: object, name: str, *, timeout_s: float = PATIENCE_S, request: Request | None = None) -> bytes:
    client = await graph.create_client(name, TRIGGER)  # type: ignore[attr-defined]
    try:
        return bytes(await client.call(request or Request(EMPTY), timeout_s))
    finally:
        await client.close()


async def test_views_call_each_other(place: Place) -> None:
    """A service of one view is called by another view, by itself, and from the network."""
    provider, other = place.hub.view("provider"), place.hub.view("other")
    await provider.create_service("/s", TRIGGER, says(b"hi"))  # type: ignore[arg-type]
    assert await call(other, "/s") == EMPTY + b"hi"
    assert await call(provider, "/s") == EMPTY + b"hi"
    assert await call(place.robot, "/s") == EMPTY + b"hi"


async def test_network_service(place: Place) -> None:
    """A view calls what a robot on the network serves."""
    await place.robot.create_service("/r", TRIGGER, says(b"robot"))  # type: ignore[arg-type]
    assert await call(place.hub.view("a"), "/r") == EMPTY + b"robot"


async def test_second_waits_and_takes_over(place: Place) -> None:
    """Who offers a name that another view holds is told so, and takes over when that one leaves."""
    first, second, caller = (place.hub.view(n) for n in ("first", "second", "caller"))
    one = await first.create_service("/s", TRIGGER, says(b"1"))  # type: ignore[arg-type]
    two = await second.create_service("/s", TRIGGER, says(b"2"))  # type: ignore[arg-type]
    told: list[str] = []
    two.on_state(told.append)
    assert (one.taken_by, two.taken_by, told) == ("", "first", ["first"])
    assert await call(caller, "/s") == EMPTY + b"1"
    await first.close()
    assert told == ["first", ""]
    assert await call(caller, "/s") == EMPTY + b"2"
    assert await call(place.robot, "/s") == EMPTY + b"2"


async def test_network_provider_is_first(place: Place) -> None:
    """A name that a node of the network serves is left to it until it goes."""
    theirs = await place.robot.create_service("/s", TRIGGER, says(b"robot"))  # type: ignore[arg-type]
    ours = await place.hub.view("us").create_service("/s", TRIGGER, says(b"us"))  # type: ignore[arg-type]
    assert "/robot" in ours.taken_by
    caller = await place.participant("/caller")
    assert await call(caller, "/s") == EMPTY + b"robot"
    await theirs.close()
    await until(lambda: ours.taken_by == "")
    assert await call(caller, "/s") == EMPTY + b"us"


async def test_same_call_runs_once(place: Place) -> None:
    """A call that is repeated with its id gets the same answer, and its handler runs once."""
    runs = []

    async def handler(request: Request) -> bytes:
        runs.append(request.id)
        await asyncio.sleep(0.01)
        return EMPTY + b"done"

    await place.hub.view("provider").create_service("/s", TRIGGER, handler)
    request = Request(EMPTY)
    a, b = place.hub.view("a"), place.hub.view("b")
    answers = [*await asyncio.gather(call(a, "/s", request=request), call(b, "/s", request=request))]
    answers.append(await call(a, "/s", request=request))
    assert answers == [EMPTY + b"done"] * 3
    assert len(runs) == 1
    assert place.hub.calls.repeated == 2


async def test_a_server_that_is_not_reached_in_a_short_time(place: Place) -> None:
    """Who gives a call less time than reaching a server may take hears of the time, not that nobody serves it."""
    await place.robot.create_service("/s", "std_srvs/srv/SetBool", says(b""))  # type: ignore[arg-type]
    view = place.hub.view("a")
    await until(lambda: place.hub.graph.services()["/s"].servers)
    with pytest.raises(CallTimeout):
        await call(view, "/s", timeout_s=0.05)  # of a type that is never reached
    with pytest.raises(NotServed):
        await call(view, "/other", timeout_s=0.05)


async def test_failure_is_not_repeated(place: Place) -> None:
    """A call that failed at the provider is not run again under its id; one that nobody served may be."""
    runs = []

    async def handler(request: Request) -> bytes:
        runs.append(1)
        raise CallFailed("/s", "broken")

    view, request = place.hub.view("a"), Request(EMPTY)
    with pytest.raises(NotServed):
        await call(view, "/s", timeout_s=0.05, request=request)
    await place.hub.view("provider").create_service("/s", TRIGGER, handler)
    for _ in range(2):
        with pytest.raises(CallFailed, match="broken"):
            await call(view, "/s", request=request)
    assert len(runs) == 1


async def test_a_long_answer_is_not_kept(place: Place) -> None:
    """A call with a long answer does not run again, and its repetition is told that it was answered."""
    runs = []

    async def handler(request: Request) -> bytes:
        runs.append(1)
        return EMPTY + bytes(100_000)

    await place.hub.view("provider").create_service("/s", TRIGGER, handler)
    view, request = place.hub.view("a"), Request(EMPTY)
    assert await call(view, "/s", request=request) == EMPTY + bytes(100_000)
    with pytest.raises(CallFailed, match="this call was answered before"):
        await call(view, "/s", request=request)
    assert len(runs) == 1


async def test_circles_end(place: Place) -> None:
    """A call that has passed this gateway before is refused."""
    await place.hub.view("provider").create_service("/s", TRIGGER, says(b""))  # type: ignore[arg-type]
    with pytest.raises(CallFailed, match="circle"):
        await call(place.hub.view("a"), "/s", request=Request(EMPTY, via=("far", "us")))


async def test_provider_leaves_in_mid_call(place: Place) -> None:
    """Calls under way fail at once when the view that serves them closes."""
    started = asyncio.Event()

    async def handler(request: Request) -> bytes:
        started.set()
        await asyncio.Event().wait()
        return b""

    provider = place.hub.view("provider")
    await provider.create_service("/s", TRIGGER, handler)
    async with aio.TaskGroup() as group:
        caller = group.create_task(_lost(place))
        await started.wait()
        await provider.close()
        await caller


async def _lost(place: Place) -> None:
    with pytest.raises(ProviderLost):
        await call(place.hub.view("a"), "/s")


async def test_timeout(place: Place) -> None:
    """A handler that takes too long is given up, and the caller gets ``CallTimeout``."""
    ended = asyncio.Event()

    async def handler(request: Request) -> bytes:
        try:
            await asyncio.Event().wait()
        finally:
            ended.set()
        return b""

    await place.hub.view("provider").create_service("/s", TRIGGER, handler)
    with pytest.raises(CallTimeout):
        await call(place.hub.view("a"), "/s", timeout_s=0.02)
    assert ended.is_set()


async def test_late_provider(place: Place) -> None:
    """A call waits a moment for a view that begins to serve the name."""
    async with aio.TaskGroup() as group:
        answer = group.create_task(call(place.hub.view("a"), "/s"))
        await asyncio.sleep(0)
        await place.hub.view("provider").create_service("/s", TRIGGER, says(b"late"))  # type: ignore[arg-type]
    assert answer.result() == EMPTY + b"late"


async def test_goal_between_views(place: Place) -> None:
    """A goal goes to the view that serves the action, with feedback, and ends as its handler says."""

    async def execute(goal: ServerGoal) -> Outcome:
        goal.feedback(EMPTY + b"half")
        await goal.cancelled.wait()
        return Outcome(GoalStatus.CANCELED, EMPTY + b"so far")

    await place.hub.view("provider").create_action_server("/a", FIBONACCI, ActionHandlers(execute))
    client = await place.hub.view("user").create_action_client("/a", FIBONACCI)
    feedback: list[bytes] = []
    goal = await client.send_goal(Goal(EMPTY), on_feedback=feedback.append)
    await until(lambda: feedback)
    assert await goal.cancel()
    assert await goal.result(PATIENCE_S) == Outcome(GoalStatus.CANCELED, EMPTY + b"so far")
    assert feedback == [EMPTY + b"half"]
    assert not await goal.cancel()


async def test_goal_of_provider_that_leaves(place: Place) -> None:
    """A goal is aborted at once when the view that carries it out closes."""

    async def execute(goal: ServerGoal) -> Outcome:
        await asyncio.Event().wait()
        raise AssertionError

    provider = place.hub.view("provider")
    await provider.create_action_server("/a", FIBONACCI, ActionHandlers(execute))
    client = await place.hub.view("user").create_action_client("/a", FIBONACCI)
    goal = await client.send_goal(Goal(EMPTY))
    await provider.close()
    assert (await goal.result(1)).status is GoalStatus.ABORTED


class _Nothing:
    async def close(self) -> None:
        return


class _Shown:
    """What a graph tells of the providers of /s."""

    def __init__(self) -> None:
        self.servers: tuple[ProviderInfo, ...] = ()

    def __call__(self, name: str) -> ServiceInfo:
        return ServiceInfo(name, (TRIGGER,), self.servers)


async def _nothing() -> _Nothing:
    return _Nothing()


async def test_younger_gateway_gives_way() -> None:
    """Of two gateways that begin to serve a name unseen by each other, the older keeps it."""
    shown = _Shown()
    holders: NameOwners[str] = NameOwners("service", "dds:0", "us", shown)
    entry = Claim("/s", "route", "", _nothing)
    await holders.add(entry)
    assert entry.serving
    shown.servers = (ProviderInfo(gateway="them", since_ns=entry.since_ns + 10),)
    await holders.settle("/s")
    assert entry.serving
    shown.servers = (replace(shown.servers[0], since_ns=entry.since_ns - 10),)
    await holders.settle("/s")
    assert not entry.serving
    assert entry.taken_by == "gateway them"
    shown.servers = ()
    await holders.settle("/s")
    assert entry.serving


async def test_hub_close_ends_lingering_clients() -> None:
    """A hub that closes takes the shared clients of its graph with it."""
    graph = MemoryGraph("hub-calls-linger")
    await graph.open()
    hub = Hub(graph)
    await hub.open()
    view = hub.view("a")
    with pytest.raises(NotServed):
        await call(view, "/s", timeout_s=0.01)
    await view.close()
    await hub.close()
    assert not hub.calls._clients
    await graph.close()
