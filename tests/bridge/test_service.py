"""ropeway.bridge.service and ropeway.graph.begun: warm calls over two DDS networks, which take no task."""

from __future__ import annotations

import asyncio
import itertools
from collections.abc import AsyncIterator
from contextlib import AsyncExitStack

import pytest

from ropeway.bridge.options import BridgeOptions
from ropeway.bridge.service import ServiceBridge
from ropeway.graph.begun import Begun, into
from ropeway.graph.calls import Request
from ropeway.hub.calls import ViewClient
from ropeway.hub.hub import Hub
from ropeway.networks.dds import DdsGraph
from ropeway.networks.dds import client as client_module
from ropeway.networks.dds.service import DdsService
from tests.networks.dds.calls import Adder, add, called
from tests.support.services import ADD, addends, total
from tests.support.until import PATIENCE_S, until

_domains = itertools.cycle(range(56, 60))


class Sides:
    """A server on one DDS network, a bridge through a hub, and a caller on another network."""

    def __init__(self, stack: AsyncExitStack) -> None:
        self.stack = stack
        self.adder = Adder()

    async def _graph(self, domain: int, name: str) -> DdsGraph:
        graph = DdsGraph(domain, name=name, interface="lo")
        await graph.open()
        self.stack.push_async_callback(graph.close)
        return graph

    async def open(self, timeout_s: float | None = None) -> None:
        """Join them, and wait until a call passes."""
        near, far = next(_domains), next(_domains)
        server, self.caller = await self._graph(far, "server"), await self._graph(near, "caller")
        self.service = await server.create_service("/add", ADD, self.adder)
        self.hub = Hub(await self._graph(far, "far"), gateway_id="us")
        await self.hub.open()
        self.stack.push_async_callback(self.hub.close)
        target = await self._graph(near, "near")
        options = BridgeOptions(timeout_s=timeout_s)
        self.bridge = ServiceBridge(self.hub.view("bridge"), target, "/add", "/add", ADD, options)
        await self.bridge.start()
        self.stack.push_async_callback(self.bridge.close)
        self.client = await called(self.caller, "/add")
        await add(self.client, 1)
        self.adder.requests.clear()

    @property
    def offered(self) -> DdsService:
        """Return the service that the bridge offers."""
        assert isinstance(self.bridge._server, DdsService)
        return self.bridge._server

    @property
    def using(self) -> ViewClient:
        """Return the client that the bridge uses."""
        assert isinstance(self.bridge._client, ViewClient)
        return self.bridge._client

    async def under_way(self, count: int = 1) -> None:
        """Wait until so many calls are at the server, none of which has a task in the bridge."""
        await until(lambda: len(self.adder.requests) == count)
        assert len(self.offered._begun) == count
        assert not self.offered._serving.tasks


@pytest.fixture
async def sides(monkeypatch: pytest.MonkeyPatch) -> AsyncIterator[Sides]:
    """Sides on which a match counts as old at once, so that requests are not repeated."""
    monkeypatch.setattr(client_module, "_FRESH_S", 0.0)
    async with AsyncExitStack() as stack:
        yield Sides(stack)


async def test_warm_calls(sides: Sides) -> None:
    """Warm calls pass without a task, each is answered once and with its own answer, and nothing of them is left."""
    await sides.open()
    sides.adder.open.clear()
    calls = [asyncio.create_task(add(sides.client, i, 1)) for i in range(5)]
    await sides.under_way(5)
    sides.adder.open.set()
    assert await asyncio.gather(*calls) == [1, 2, 3, 4, 5]
    assert sides.bridge.counts["answered"] == 6
    assert sides.bridge.under_way == 0
    assert not sides.using.busy
    assert len({request.id for request in sides.adder.requests}) == 5


async def test_many_at_once(sides: Sides) -> None:
    """What there is no room for at once waits its turn: a thousand calls at a time are all answered once."""
    await sides.open()
    assert await asyncio.gather(*(add(sides.client, i) for i in range(1000))) == list(range(1000))
    assert len(sides.adder.requests) == 1000
    assert sides.bridge.counts == {"answered": 1001}


async def test_time_is_over(sides: Sides) -> None:
    """A call that takes longer than its route allows is answered with the default response, and counted."""
    await sides.open(timeout_s=0.5)
    sides.adder.open.clear()
    assert await add(sides.client, 5) == 0
    assert sides.bridge.counts["CallTimeout"] == 1
    assert sides.bridge.under_way == 0


async def test_server_leaves(sides: Sides) -> None:
    """A call whose server leaves is answered with the default response, and counted."""
    await sides.open()
    sides.adder.open.clear()
    call = asyncio.create_task(add(sides.client, 5))
    await sides.under_way()
    await sides.service.close()
    await until(lambda: sides.bridge.counts["ProviderLost"] == 1)
    await asyncio.wait({call})
    assert sides.bridge.under_way == 0


async def test_client_is_closed(sides: Sides) -> None:
    """Calls under way at a client that is closed fail as those of a provider that was lost."""
    await sides.open()
    sides.adder.open.clear()
    call = asyncio.create_task(add(sides.client, 5))
    await sides.under_way()
    await sides.using.close()
    assert await call == 0
    assert sides.bridge.counts["GraphUnavailable"] == 1
    assert not sides.using.busy


async def test_bridge_is_closed(sides: Sides) -> None:
    """A bridge that is closed gives its calls up, and forgets them."""
    await sides.open()
    sides.adder.open.clear()
    call = asyncio.create_task(add(sides.client, 5))
    await sides.under_way()
    offered = sides.offered
    await sides.bridge.close()
    assert sides.bridge.counts["given up"] == 1
    assert not offered._begun
    await asyncio.wait({call})


async def test_same_call_twice(sides: Sides) -> None:
    """A call that was made before, by whatever way, is not begun again, and gets the same answer."""
    await sides.open()
    request = Request(addends(2, 3))
    first: asyncio.Future[bytes] = asyncio.get_running_loop().create_future()
    begun = sides.using.begin(request, PATIENCE_S, into(first))
    assert isinstance(begun, Begun)
    assert sides.using.begin(request, PATIENCE_S, into(first)) is None
    assert await sides.using.call(request, PATIENCE_S) == await first == total(5)
    assert len(sides.adder.requests) == 1


async def test_circles(sides: Sides) -> None:
    """A call that passed this gateway before is not begun."""
    await sides.open()
    request = Request(addends(2, 3), via=("us",))
    assert sides.using.begin(request, PATIENCE_S, lambda _: None) is None
    assert not sides.using.busy


async def test_given_up(sides: Sides) -> None:
    """A call that is given up ends once, and its answer counts as late."""
    await sides.open()
    sides.adder.open.clear()
    ends: list[object] = []
    begun = sides.using.begin(Request(addends(2, 3)), PATIENCE_S, ends.append)
    assert begun is not None
    await until(lambda: sides.adder.requests)
    begun.give_up()
    begun.give_up()
    sides.adder.open.set()
    inner = sides.using._inner
    await until(lambda: getattr(inner, "late", 0) == 1)
    assert [type(how) for how in ends] == [asyncio.CancelledError]
