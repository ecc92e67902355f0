"""Services and actions of the ``memory`` graph, beyond what all kinds share."""

from __future__ import annotations

import asyncio
import itertools
import struct
from collections.abc import AsyncIterator

import pytest

from ropeway import aio
from ropeway.errors import NotServed, TypeConflict, UnknownType
from ropeway.graph.calls import ActionHandlers, Goal, Outcome, Request, ServerGoal
from ropeway.networks.memory.graph import MemoryGraph
from tests.support.actions import FIBONACCI
from tests.support.services import ADD
from tests.support.until import PATIENCE_S

pytestmark = pytest.mark.jumping

_numbers = itertools.count()


@pytest.fixture
async def graphs() -> AsyncIterator[list[MemoryGraph]]:
    """Three participants of one network."""
    number = next(_numbers)
    made = [MemoryGraph(f"calls-{number}", node=f"/node{i}") for i in range(3)]
    for graph in made:
        await graph.open()
    yield made
    for graph in made:
        await graph.close()


def number(value: int) -> bytes:
    """An AddTwoInts_Response as CDR."""
    return b"\0\1\0\0" + struct.pack("<q", value)


async def one(request: Request) -> bytes:
    """Answer 1."""
    return number(1)


async def two(request: Request) -> bytes:
    """Answer 2."""
    return number(2)


async def test_not_its_own(graphs: list[MemoryGraph]) -> None:
    """A participant does not reach the service that it serves itself."""
    await graphs[0].create_service("/add", ADD, one)
    client = await graphs[0].create_client("/add", ADD)
    assert not client.available
    with pytest.raises(NotServed):
        await client.call(Request(number(0)), 0.05)


async def test_first_answers(graphs: list[MemoryGraph]) -> None:
    """Of two services of a name the first answers, and the second when the first has closed."""
    first = await graphs[0].create_service("/add", ADD, one)
    await graphs[1].create_service("/add", ADD, two)
    client = await graphs[2].create_client("/add", ADD)
    assert await client.call(Request(number(0))) == number(1)
    await first.close()
    assert await client.call(Request(number(0))) == number(2)


async def test_other_type(graphs: list[MemoryGraph]) -> None:
    """A service of another type is not reached."""
    await graphs[0].create_service("/add", "std_srvs/srv/Trigger", one)
    client = await graphs[1].create_client("/add", ADD)
    with pytest.raises(NotServed):
        await client.call(Request(number(0)), 0.05)
    assert graphs[1].services()["/add"].types == ("std_srvs/srv/Trigger", ADD)


async def test_no_type(graphs: list[MemoryGraph]) -> None:
    """A service needs a type."""
    with pytest.raises(TypeConflict):
        await graphs[0].create_client("/add", "")


async def test_request_is_handed_on(graphs: list[MemoryGraph]) -> None:
    """The handler gets the id, the way and the caller of a request, and how long the caller waits."""
    seen: list[Request] = []

    async def keep(request: Request) -> bytes:
        seen.append(request)
        return number(0)

    await graphs[0].create_service("/add", ADD, keep)
    client = await graphs[1].create_client("/add", ADD)
    request = Request(number(5), via=("a",), caller="me")
    await client.call(request, 3)
    assert (seen[0].payload, seen[0].id, seen[0].via, seen[0].caller) == (number(5), request.id, ("a",), "me")
    assert seen[0].timeout_s == pytest.approx(3, abs=0.5)


async def test_caller_leaves(graphs: list[MemoryGraph]) -> None:
    """A handler whose caller has left is ended."""
    began, ended = asyncio.Event(), asyncio.Event()

    async def forever(request: Request) -> bytes:
        began.set()
        try:
            await asyncio.Event().wait()
        finally:
            ended.set()
        raise AssertionError

    await graphs[0].create_service("/add", ADD, forever)
    client = await graphs[1].create_client("/add", ADD)
    call = asyncio.create_task(client.call(Request(number(0)), 50))
    await began.wait()
    call.cancel()
    async with aio.timeout(PATIENCE_S):
        await ended.wait()


async def test_waiter_hears_of_close(graphs: list[MemoryGraph]) -> None:
    """Who waits for a service learns when the client closes."""
    client = await graphs[0].create_client("/add", ADD)
    waiting = asyncio.create_task(client.wait_available(50))
    await asyncio.sleep(0)
    await client.close()
    async with aio.timeout(PATIENCE_S):
        assert not await waiting


async def test_nodes(graphs: list[MemoryGraph]) -> None:
    """A node is listed with the services that it serves and calls."""
    await graphs[0].create_service("/add", "example_interfaces/AddTwoInts", one)
    await graphs[1].create_client("/add", ADD)
    nodes = graphs[2].nodes()
    assert nodes["/node0"].services == (("/add", ADD),)
    assert nodes["/node1"].clients == (("/add", ADD),)


async def test_action_parts(graphs: list[MemoryGraph]) -> None:
    """The services of an action are listed as services, its topics are not listed as topics."""

    async def never(goal: ServerGoal) -> Outcome:
        raise AssertionError

    await graphs[0].create_action_server("/count", FIBONACCI, ActionHandlers(never))
    assert list(graphs[1].services()) == [
        f"/count/_action/{part}" for part in ("cancel_goal", "get_result", "send_goal")
    ]
    assert graphs[1].topics() == {}
    assert list(graphs[1].actions()) == ["/count"]


async def test_unknown_action(graphs: list[MemoryGraph]) -> None:
    """An action of an unknown type is refused."""
    with pytest.raises(UnknownType):
        await graphs[0].create_action_client("/count", "a/action/B")


async def test_close_closes_everything(graphs: list[MemoryGraph]) -> None:
    """A graph that closes leaves nothing on the network."""
    began = asyncio.Event()

    async def forever(goal: ServerGoal) -> Outcome:
        began.set()
        await asyncio.Event().wait()
        raise AssertionError

    await graphs[0].create_action_server("/count", FIBONACCI, ActionHandlers(forever))
    await graphs[0].create_service("/add", ADD, one)
    client = await graphs[1].create_action_client("/count", FIBONACCI)
    await graphs[1].create_client("/add", ADD)
    await client.send_goal(Goal(b"\0\1\0\0\1\0\0\0"))
    await began.wait()
    await graphs[0].close()
    await graphs[1].close()
    network = graphs[2].network
    assert not (network.publishers or network.subscriptions or network.services or network.clients)
