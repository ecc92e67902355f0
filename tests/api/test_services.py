"""Clients and services of programs."""

from __future__ import annotations

import asyncio
from typing import Any

import pytest

import ropeway
from ropeway import CallFailed, CallTimeout, GraphUnavailable, NotServed, TypedMessage, ValueMismatch, WaitTimeout
from tests.api.conftest import new_network

ADD = "example_interfaces/srv/AddTwoInts"


def add(request: TypedMessage) -> dict[str, int]:
    return {"sum": request["a"] + request["b"]}


async def add_later(request: TypedMessage) -> dict[str, int]:
    await asyncio.sleep(0)
    return add(request)


@pytest.mark.parametrize("handler", [add, add_later])
async def test_call(url: str, handler: Any) -> None:
    """A service of one program answers another, by a function or a coroutine function."""
    async with (
        ropeway.open(url, name="server") as server,
        ropeway.open(url, name="client") as caller,
        server.serve("add", "example_interfaces/AddTwoInts", handler) as service,
    ):
        assert (service.service, service.type, service.taken_by) == ("/add", ADD, "")
        assert (await caller.call("/add", {"a": 1, "b": 2}, timeout_s=20))["sum"] == 3
        async with caller.client("/add") as client:
            assert (client.service, client.type, client.available) == ("/add", ADD, True)
            answers = await asyncio.gather(*(client.call({"a": n, "b": 1}, timeout_s=20) for n in range(20)))
            assert [answer["sum"] for answer in answers] == list(range(1, 21))


async def test_own_service(network: str) -> None:
    """A program calls a service of its own on the same graph."""
    async with ropeway.open(network) as graph, graph.serve("/add", ADD, add):
        assert (await graph.call("/add", {"a": 1}, ADD))["sum"] == 1


async def test_what_goes_wrong(network: str) -> None:
    """A call fails with what the handler says, with its time, or because nobody serves it; the service goes on."""

    async def handler(request: TypedMessage) -> object:
        if request["a"] == 1:
            raise ropeway.CallFailed("/add", "battery low")
        if request["a"] == 2:
            raise ValueError("what was that")
        if request["a"] == 3:
            return {"nothing": 1}
        if request["a"] == 4:
            await asyncio.Event().wait()
        return {"sum": 5}

    async with ropeway.open(network) as graph, ropeway.open(network) as caller:
        async with graph.serve("/add", ADD, handler), caller.client("/add", ADD) as client:
            with pytest.raises(CallFailed, match="battery low"):
                await client.call({"a": 1})
            with pytest.raises(CallFailed, match="what was that"):
                await client.call({"a": 2})
            with pytest.raises(CallFailed, match="nothing"):
                await client.call({"a": 3})
            with pytest.raises(CallTimeout):
                await client.call({"a": 4}, timeout_s=0.05)
            with pytest.raises(ValueMismatch, match="a"):
                await client.call({"a": "x"})
            assert (await client.call({"a": 5}))["sum"] == 5
        with pytest.raises(NotServed):
            await caller.call("/add", type=ADD, timeout_s=0.05)
        with pytest.raises(WaitTimeout, match="no server of /sub"):
            await caller.call("/sub", timeout_s=0.05)


async def test_service_comes_later(network: str) -> None:
    """A call waits for its service within its time."""
    async with (
        ropeway.open(network) as graph,
        ropeway.open(network) as caller,
        caller.client("/add", ADD) as client,
    ):
        waiting = asyncio.create_task(client.call({"a": 2, "b": 2}, timeout_s=20))
        await asyncio.sleep(0)
        async with graph.serve("/add", ADD, add):
            assert (await waiting)["sum"] == 4


async def test_close_ends_calls(network: str) -> None:
    """Calls under way fail when their client is closed."""

    async def never(request: TypedMessage) -> None:
        called.set()
        await asyncio.Event().wait()

    called = asyncio.Event()
    async with ropeway.open(network) as graph, graph.serve("/wait", "std_srvs/Empty", never):
        client = await graph.client("/wait")
        waiting = asyncio.create_task(client.call())
        await called.wait()
        await client.close()
        with pytest.raises(GraphUnavailable):
            await waiting


async def test_name_that_is_taken(network: str) -> None:
    """A second service of a name waits until the first has gone, and says who has it."""
    async with ropeway.open(network) as graph:
        first = await graph.serve("/add", ADD, add)
        async with graph.serve("/add", ADD, lambda request: {"sum": 99}) as second:
            assert second.taken_by
            await first.close()
            assert (await graph.call("/add"))["sum"] == 99


async def test_rosapi() -> None:
    """The services of a gateway itself can be called, though it does not list them."""
    config = {"gateway": {"graphs": [new_network()], "listen": ["ws://127.0.0.1:0"]}}
    async with ropeway.open_gateway(config) as gateway, ropeway.open(f"ws://127.0.0.1:{gateway.ports[0]}") as graph:
        answer = await graph.call("/rosapi/topics", type="rosapi_msgs/Topics", timeout_s=20)
        assert "/rosout" in answer["topics"]
        with pytest.raises(NotServed):
            await graph.call("/rosapi/nothing", type="rosapi_msgs/Topics", timeout_s=20)
