"""What every kind of graph does with services."""

from __future__ import annotations

import asyncio
import random
import struct
from collections import Counter
from collections.abc import Callable

import pytest

from ropeway import aio
from ropeway.errors import (
    CallError,
    CallFailed,
    CallTimeout,
    GraphError,
    GraphUnavailable,
    InvalidName,
    NotServed,
    ProviderLost,
)
from ropeway.graph.base import GraphEvent
from ropeway.graph.calls import Client, Request, Service
from tests.support.messages import text
from tests.support.services import ADD, TEXT, Gate, add, addends, answer, total
from tests.support.until import PATIENCE_S, until

from .conftest import Pair


async def calling(pair: Pair, name: str, handler: Callable[[Request], object], type: str = ADD) -> Client:
    """A client of ``near`` for a service of ``far`` that is there."""
    await pair.far.create_service(name, type, handler)  # type: ignore[arg-type]
    client = await pair.near.create_client(name, type)
    assert await client.wait_available(PATIENCE_S)
    return client


async def test_protocols(pair: Pair) -> None:
    """A client and a service satisfy the protocols."""
    service = await pair.far.create_service("/add", ADD, add)
    client = await pair.near.create_client("/add", ADD)
    assert isinstance(service, Service)
    assert isinstance(client, Client)
    assert (service.service, service.type, client.service, client.type) == ("/add", ADD, "/add", ADD)


async def test_answers(pair: Pair) -> None:
    """The response of a call arrives byte for byte."""
    client = await calling(pair, "/add", add)
    assert await client.call(Request(addends(40, 2))) == total(42)


async def test_request_arrives(pair: Pair) -> None:
    """The handler gets the request byte for byte, and once."""
    gate = Gate()
    gate.open.set()
    client = await calling(pair, "/add", gate)
    await client.call(Request(addends(-1, 2**62)))
    assert [bytes(request.payload) for request in gate.seen] == [addends(-1, 2**62)]


async def test_both_ways(pair: Pair) -> None:
    """Both participants can serve and call at once."""
    there = await calling(pair, "/there", add)
    await pair.near.create_service("/back", ADD, add)
    back = await pair.far.create_client("/back", ADD)
    assert await back.wait_available(PATIENCE_S)
    answers = await asyncio.gather(there.call(Request(addends(1))), back.call(Request(addends(2))))
    assert list(answers) == [total(1), total(2)]


async def test_big(pair: Pair) -> None:
    """A request and a response of 1 MB arrive whole."""
    big = "".join(random.Random(1).choices("abcdefghij", k=1_000_000))

    async def echo(request: Request) -> bytes:
        return answer(bytes(request.payload[8:-1]).decode()[::-1])

    client = await calling(pair, "/echo", echo, TEXT)
    response = await client.call(Request(text(big)), 20)
    assert pair.exactly(response, f"{TEXT}_Response") == answer(big[::-1])


async def test_out_of_order(pair: Pair) -> None:
    """Calls that are answered in another order than they were made get each their own response."""
    turns = [asyncio.Event() for _ in range(8)]

    async def in_turn(request: Request) -> bytes:
        number = struct.unpack("<qq", request.payload[4:20])[0]
        await turns[number].wait()
        return await add(request)

    client = await calling(pair, "/add", in_turn)
    calls = [asyncio.create_task(client.call(Request(addends(i, 100)), 20)) for i in range(8)]
    for i in reversed(range(8)):
        turns[i].set()
        assert await calls[i] == total(100 + i)
        assert not any(call.done() for call in calls[:i])


async def test_concurrent(pair: Pair) -> None:
    """200 calls at a time are each carried out once and answered once."""
    counted: Counter[int] = Counter()

    async def count(request: Request) -> bytes:
        counted[struct.unpack("<qq", request.payload[4:20])[0]] += 1
        await asyncio.sleep(0)
        return await add(request)

    client = await calling(pair, "/add", count)
    answers = await asyncio.gather(*(client.call(Request(addends(i, i)), 30) for i in range(200)))
    assert answers == [total(2 * i) for i in range(200)]
    assert counted == Counter(range(200))


async def test_two_clients(pair: Pair) -> None:
    """Two clients of one service get each their own responses."""
    first = await calling(pair, "/add", add)
    second = await pair.near.create_client("/add", ADD)
    assert await second.wait_available(PATIENCE_S)
    answers = await asyncio.gather(
        *(client.call(Request(addends(i, which))) for i in range(20) for which, client in ((100, first), (200, second)))
    )
    assert answers == [total(i + which) for i in range(20) for which in (100, 200)]


async def test_handler_fails(pair: Pair) -> None:
    """A handler that raises fails its own call with its text, where the network has room for one."""

    async def moody(request: Request) -> bytes:
        if request.payload == addends(13):
            raise CallFailed("/add", "thirteen is not for adding")
        if request.payload == addends(0):
            raise ZeroDivisionError("nothing there")
        return await add(request)

    client = await calling(pair, "/add", moody)
    for payload, words in ((addends(13), "thirteen is not for adding"), (addends(0), "nothing there")):
        if pair.can.errors:
            with pytest.raises(CallFailed, match=words):
                await client.call(Request(payload))
        else:
            assert await client.call(Request(payload)) == total(0)
    assert await client.call(Request(addends(1))) == total(1)


async def test_not_served(pair: Pair) -> None:
    """A call of what nobody serves fails with the name."""
    client = await pair.near.create_client("/nobody/home", ADD)
    with pytest.raises(NotServed, match="/nobody/home") as caught:
        await client.call(Request(addends(1)), 0.5)
    assert caught.value.name == "/nobody/home"


async def test_not_available(pair: Pair) -> None:
    """A client says that nobody serves it, where the network can tell."""
    client = await pair.near.create_client("/nobody", ADD)
    assert not client.available
    assert await client.wait_available(0.2) is (client.available is None)


async def test_timeout(pair: Pair) -> None:
    """A call that is not answered in time fails, and the next one is answered."""
    gate = Gate()
    client = await calling(pair, "/add", gate)
    with pytest.raises(CallTimeout) as caught:
        await client.call(Request(addends(1)), 0.3)
    assert caught.value.name == "/add"
    gate.open.set()
    assert await client.call(Request(addends(2))) == total(2)


async def test_given_up(pair: Pair) -> None:
    """A caller that is cancelled leaves the others their responses."""
    gate = Gate()
    client = await calling(pair, "/add", gate)
    calls = [asyncio.create_task(client.call(Request(addends(i)), 20)) for i in range(3)]
    await until(lambda: len(gate.seen) == 3)
    calls[1].cancel()
    with pytest.raises(asyncio.CancelledError):
        await calls[1]
    gate.open.set()
    assert [await calls[0], await calls[2]] == [total(0), total(2)]


async def test_provider_closes(pair: Pair) -> None:
    """A service that closes fails the calls it has not answered at once."""
    gate = Gate()
    service = await pair.far.create_service("/add", ADD, gate)
    client = await pair.near.create_client("/add", ADD)
    assert await client.wait_available(PATIENCE_S)
    calls = [asyncio.create_task(client.call(Request(addends(i)), 50)) for i in range(3)]
    await until(lambda: len(gate.seen) == 3)
    await service.close()
    async with aio.timeout(PATIENCE_S):
        failures = await asyncio.gather(*calls, return_exceptions=True)
    assert [type(failure) for failure in failures] == [ProviderLost] * 3, failures
    await service.close()


async def test_client_closes(pair: Pair) -> None:
    """A client that closes fails its calls under way, and later ones."""
    gate = Gate()
    client = await calling(pair, "/add", gate)
    call = asyncio.create_task(client.call(Request(addends(1)), 50))
    await until(lambda: gate.seen)
    await client.close()
    async with aio.timeout(PATIENCE_S):
        with pytest.raises(GraphUnavailable):
            await call
    with pytest.raises(GraphUnavailable):
        await client.call(Request(addends(1)))
    await client.close()


async def test_late_provider(pair: Pair) -> None:
    """A client finds a service that begins later."""
    client = await pair.near.create_client("/add", ADD)
    waiting = asyncio.create_task(client.wait_available(20))
    service = await pair.far.create_service("/add", ADD, add)
    assert await waiting
    await until(lambda: client.available is not False)
    assert await client.call(Request(addends(1))) == total(1)
    await service.close()
    await until(lambda: not client.available)


async def test_returning_provider(pair: Pair) -> None:
    """A service that closed and begins again is called again."""
    client = await pair.near.create_client("/add", ADD)
    for number in range(3):
        service = await pair.far.create_service("/add", ADD, add)
        assert await client.wait_available(PATIENCE_S)
        assert await client.call(Request(addends(number))) == total(number)
        await service.close()
        await until(lambda: not client.available)


async def test_graph_closes(pair: Pair) -> None:
    """A graph that closes fails its calls under way."""
    gate = Gate()
    await pair.far.create_service("/add", ADD, gate)
    client = await pair.near.create_client("/add", ADD)
    assert await client.wait_available(PATIENCE_S)
    call = asyncio.create_task(client.call(Request(addends(1)), 50))
    await until(lambda: gate.seen)
    await pair.near.close()
    async with aio.timeout(PATIENCE_S):
        with pytest.raises(GraphError):
            await call


async def test_listed(pair: Pair) -> None:
    """A service is listed with its type and who serves it, and listed no more when it closes."""
    service = await pair.far.create_service("/listed", ADD, add)
    await until(lambda: "/listed" in pair.near.services() and pair.near.services()["/listed"].servers)
    info = pair.near.services()["/listed"]
    assert (info.name, info.type) == ("/listed", ADD)
    assert [server.local for server in info.servers] == [False]
    assert [server.local for server in pair.far.services()["/listed"].servers] == [True]
    await service.close()
    await until(lambda: "/listed" not in pair.near.services() or not pair.near.services()["/listed"].servers)


async def test_events(pair: Pair) -> None:
    """A service that comes or goes is told as an event."""
    seen: list[GraphEvent] = []

    async def listen() -> None:
        async for event in changes:
            if event.kind == "service" and event.name == "/told":
                seen.append(event)

    changes = pair.near.changes()
    listener = asyncio.create_task(listen())
    service = await pair.far.create_service("/told", ADD, add)
    await until(lambda: seen)
    await service.close()
    await until(lambda: len(seen) == 2)
    listener.cancel()
    assert [(event.discovered, event.type) for event in seen] == [(True, ADD), (False, ADD)]
    assert "offers service /told" in str(seen[0])


@pytest.mark.parametrize("name", ["", "/a//b", "/1st", "/a b", "/a/"])
async def test_bad_names(pair: Pair, name: str) -> None:
    """A name that ROS does not allow is refused."""
    with pytest.raises(InvalidName):
        await pair.near.create_client(name, ADD)
    with pytest.raises(InvalidName):
        await pair.near.create_service(name, ADD, add)


async def test_closed_graph(pair: Pair) -> None:
    """A graph that is closed neither serves nor calls."""
    await pair.near.close()
    with pytest.raises(GraphUnavailable):
        await pair.near.create_client("/add", ADD)
    with pytest.raises(GraphUnavailable):
        await pair.near.create_service("/add", ADD, add)


async def test_failures_are_call_errors(pair: Pair) -> None:
    """Whatever goes wrong with a call is a ``CallError`` that names the service."""
    client = await pair.near.create_client("/nothing", ADD)
    with pytest.raises(CallError) as caught:
        await client.call(Request(addends(1)), 0.2)
    assert caught.value.name == "/nothing"
