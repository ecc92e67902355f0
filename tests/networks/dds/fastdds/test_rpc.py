"""Calls between two gateways' helpers, in the mapping of Fast DDS."""

from __future__ import annotations

import asyncio
import os
import signal
from collections import Counter
from collections.abc import AsyncIterator, Awaitable, Callable

import pytest

from ropeway import aio
from ropeway.errors import CallFailed, CallTimeout, DecodeError, GraphUnavailable, NotServed, ProviderLost
from ropeway.graph.base import Undelivered
from ropeway.graph.calls import Client, Request, Service
from ropeway.networks.dds.fastdds import FastRpc, Surroundings, rpc
from ropeway.networks.dds.fastdds.frames import HelperFrame, Op
from ropeway.networks.dds.profile import make_profile
from tests.support.services import ADD
from tests.support.until import PATIENCE_S, until

CDR = b"\0\1\0\0"


def number(value: int) -> bytes:
    return CDR + value.to_bytes(8, "little")


class Echo:
    """A handler that answers with the request, once its gate is open."""

    def __init__(self, *, open: bool = True) -> None:
        self.requests: list[Request] = []
        self.gate = asyncio.Event()
        if open:
            self.gate.set()

    async def __call__(self, request: Request) -> bytes:
        self.requests.append(request)
        await self.gate.wait()
        return request.payload


Make = Callable[..., Awaitable[FastRpc]]


@pytest.fixture
async def make(domain: int) -> AsyncIterator[Make]:
    """Starts gateways' sides; all are closed."""
    made: list[FastRpc] = []

    async def start(around: Surroundings | None = None, *, everyone: bool = True) -> FastRpc:
        one = FastRpc("test", domain, make_profile("test", "lo"), gateway_id="gw", around=around, everyone=everyone)
        made.append(one)
        assert await one.start()
        return one

    yield start
    await asyncio.gather(*(one.close() for one in made))


async def pair(make: Make, around: Surroundings | None = None) -> tuple[FastRpc, FastRpc]:
    near, far = await asyncio.gather(make(around), make(around))
    return near, far


async def test_calls(make: Make) -> None:
    """Calls of all sizes are answered, many at a time, each with its own answer; the handler runs once for each."""
    near, far = await pair(make)
    echo = Echo()
    service = await far.create_service("/echo", ADD, echo)
    client = await near.create_client("/echo", ADD)
    assert isinstance(service, Service)
    assert isinstance(client, Client)
    assert not client.available
    assert await client.wait_available(PATIENCE_S)
    for payload in (CDR + b"\1", number(1), CDR + os.urandom(1002), CDR + os.urandom(1_000_001)):
        assert await client.call(Request(payload)) == payload
    asked = [number(n) for n in range(1000)]
    assert await asyncio.gather(*(client.call(Request(p), 20) for p in asked)) == asked
    assert len(echo.requests) == 1004
    assert len({request.id for request in echo.requests}) == 1004
    assert service.clients == 1


async def test_two_clients(make: Make) -> None:
    """Two clients of one service do not get each other's answers."""
    far, *near = await asyncio.gather(make(), make(), make())
    await far.create_service("/echo", ADD, Echo())
    clients = [await one.create_client("/echo", ADD) for one in near]

    async def ask(client: Client, first: int) -> None:
        assert await client.wait_available(PATIENCE_S)
        for n in range(first, first + 200):
            assert await client.call(Request(number(n))) == number(n)

    await asyncio.gather(ask(clients[0], 0), ask(clients[1], 1000))


async def test_nobody(make: Make, monkeypatch: pytest.MonkeyPatch) -> None:
    """A service that nobody serves is called in vain; one of Cyclone DDS alone counts as nobody."""
    monkeypatch.setattr(rpc, "_NOBODY_S", 0.1)
    monkeypatch.setattr(rpc, "_FRESH_S", 1.0)
    near, far = await asyncio.gather(make(everyone=False), make())
    await far.create_service("/echo", ADD, Echo())
    client = await near.create_client("/echo", ADD)
    assert not await client.wait_available(0.1)
    with pytest.raises(NotServed):
        await client.call(Request(number(1)))


async def test_no_answer(make: Make) -> None:
    """A handler that fails, or is slow, leaves its caller without an answer; the failure is counted."""
    drops: Counter[tuple[str, Undelivered]] = Counter()

    def drop(service: str, reason: Undelivered, count: int) -> None:
        drops[service, reason] += count

    near, far = await pair(make, Surroundings(drop=drop))
    echo = Echo(open=False)

    async def fail(request: Request) -> bytes:
        raise ZeroDivisionError

    await far.create_service("/slow", ADD, echo)
    await far.create_service("/broken", ADD, fail)
    slow, broken = await near.create_client("/slow", ADD), await near.create_client("/broken", ADD)
    assert await slow.wait_available(PATIENCE_S)
    assert await broken.wait_available(PATIENCE_S)
    for client in (slow, broken):
        with pytest.raises(CallTimeout):
            await client.call(Request(number(1)), 0.3)
    assert drops["/broken", Undelivered.CALLBACK] == 1
    echo.gate.set()
    assert await slow.call(Request(number(2))) == number(2)
    near.helper.send(HelperFrame(Op.PING))  # which has it tell what it counted
    await until(lambda: drops["/slow", Undelivered.LATE] == 1)


async def test_closed(make: Make) -> None:
    """What is closed calls and serves no more, and says so to those who wait."""
    near, far = await pair(make)
    echo = Echo(open=False)
    service = await far.create_service("/echo", ADD, echo)
    client = await near.create_client("/echo", ADD)
    assert await client.wait_available(PATIENCE_S)
    call = asyncio.create_task(client.call(Request(number(1))))
    await until(lambda: echo.requests)
    await service.close()
    with pytest.raises(ProviderLost, match="its server has left"):
        await call
    await until(lambda: not client.available)
    await far.create_service("/echo", ADD, echo)
    assert await client.wait_available(PATIENCE_S)
    call = asyncio.create_task(client.call(Request(number(2))))
    await until(lambda: len(echo.requests) == 2)
    await client.close()
    with pytest.raises(GraphUnavailable, match="closed in mid-call"):
        await call
    with pytest.raises(GraphUnavailable, match="is closed"):
        await client.call(Request(number(1)))
    await near.close()
    with pytest.raises(GraphUnavailable, match="it was closed"):
        await near.create_client("/echo", ADD)


async def test_helper_killed(make: Make) -> None:
    """Calls under way fail at once where the helper is killed, and later ones are answered within seconds."""
    near, far = await pair(make)
    echo = Echo(open=False)
    await far.create_service("/echo", ADD, echo)
    client = await near.create_client("/echo", ADD)
    assert await client.wait_available(PATIENCE_S)
    calls = [asyncio.create_task(client.call(Request(number(n)), 3600)) for n in range(3)]
    await until(lambda: len(echo.requests) == 3)
    os.kill(near.helper.pid, signal.SIGKILL)
    async with aio.timeout(PATIENCE_S):
        lost = await asyncio.gather(*calls, return_exceptions=True)
    assert all(isinstance(error, ProviderLost) for error in lost)
    echo.gate.set()
    assert await client.wait_available(PATIENCE_S)
    assert await client.call(Request(number(7))) == number(7)
    assert [request.payload for request in echo.requests] == [number(n) for n in (0, 1, 2, 7)]


async def test_server_killed(make: Make) -> None:
    """A service serves again after its helper was killed; requests that it was busy with are given up."""
    near, far = await pair(make)
    echo = Echo(open=False)
    service = await far.create_service("/echo", ADD, echo)
    client = await near.create_client("/echo", ADD)
    assert await client.wait_available(PATIENCE_S)
    call = asyncio.create_task(client.call(Request(number(1)), 30))
    await until(lambda: echo.requests)
    os.kill(far.helper.pid, signal.SIGKILL)
    await until(lambda: not service._serving.tasks)
    echo.gate.set()
    with pytest.raises(ProviderLost):  # when the network has forgotten the one that was killed
        await call
    assert await client.wait_available(PATIENCE_S)
    assert await client.call(Request(number(2))) == number(2)


async def test_big_endian(make: Make) -> None:
    """What the surroundings cannot read fails the call, or leaves the request out."""

    def little_endian(type: str, payload: bytes) -> bytes:
        if payload == number(13):
            raise DecodeError(type, "cdr", "unlucky")
        return payload

    near, far = await asyncio.gather(make(Surroundings(little_endian)), make())
    echo = Echo()
    await far.create_service("/echo", ADD, echo)
    client = await near.create_client("/echo", ADD)
    assert await client.wait_available(PATIENCE_S)
    with pytest.raises(CallFailed, match="the answer cannot be read"):
        await client.call(Request(number(13)))
    await near.create_service("/back", ADD, echo)
    back = await far.create_client("/back", ADD)
    assert await back.wait_available(PATIENCE_S)
    with pytest.raises(CallTimeout):
        await back.call(Request(number(13)), 0.3)
    assert await back.call(Request(number(12))) == number(12)


async def test_limits(make: Make, monkeypatch: pytest.MonkeyPatch) -> None:
    """Too many calls, and requests that are too long, fail at once."""
    near, far = await pair(make)
    echo = Echo(open=False)
    await far.create_service("/echo", ADD, echo)
    client = await near.create_client("/echo", ADD)
    assert await client.wait_available(PATIENCE_S)
    monkeypatch.setattr(rpc, "_CALLS_LIMIT", 1)
    monkeypatch.setattr(rpc, "MAX_BODY_BYTES", 100)
    with pytest.raises(CallFailed, match="51 bytes is too long"):
        await client.call(Request(bytes(51)))
    call = asyncio.create_task(client.call(Request(number(1))))
    await until(lambda: echo.requests)
    with pytest.raises(CallFailed, match="1 calls of /echo are under way"):
        await client.call(Request(number(2)))
    echo.gate.set()
    assert await call == number(1)


async def test_unfit(domain: int, caplog: pytest.LogCaptureFixture, monkeypatch: pytest.MonkeyPatch) -> None:
    """Where the self-test fails, the log says once what cannot be used and what can."""
    monkeypatch.setattr("sys.executable", "/bin/false")
    one = FastRpc("test", domain, make_profile("test", "lo"))
    assert not await one.start()
    assert not one.available
    assert caplog.text.count("services of Fast DDS nodes (rmw_fastrtps_cpp) cannot be used here") == 1
    with pytest.raises(GraphUnavailable, match="its process ended at once"):
        await one.create_client("/echo", ADD)
    await one.close()
