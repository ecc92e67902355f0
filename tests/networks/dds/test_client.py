"""Services that we call over DDS."""

from __future__ import annotations

import asyncio
import logging

import pytest

from ropeway.errors import CallFailed, CallTimeout, GraphUnavailable, NotServed, ProviderLost
from ropeway.graph.base import Sample, Undelivered
from ropeway.graph.calls import Client, Request, Service, ServiceHandler
from ropeway.networks.dds import client as module
from ropeway.networks.dds import rpc
from ropeway.networks.dds.records import MatchedEndpoint
from ropeway.networks.dds.rpc import RequestHeader
from ropeway.tasks import end
from ropeway.types import TypeRegistry
from tests.support.services import ADD, addends, total
from tests.support.until import PATIENCE_S, until

from .calls import Adder, add, called
from .conftest import Join
from .helpers import process

FAST = MatchedEndpoint(b"\x01\x0f" + bytes(14))


async def test_call(join: Join) -> None:
    """A call gets its answer, the first one as soon as the server is matched."""
    near, far = await join("near"), await join("far")
    await far.create_service("/add", ADD, Adder())
    client = await called(near, "/add")
    assert [await add(client, i, 1) for i in range(20)] == list(range(1, 21))


async def test_server_comes_late(join: Join) -> None:
    """A call that began before its server came is answered."""
    near, far = await join("near"), await join("far")
    client = await near.create_client("/add", ADD)
    assert not client.available
    calling = asyncio.create_task(add(client, 2, 3))
    await asyncio.sleep(0)  # it begins
    await far.create_service("/add", ADD, Adder())
    assert await calling == 5
    assert client.available


async def test_many_at_a_time(join: Join) -> None:
    """A thousand calls at a time, of two clients, are each answered once and with their own answer."""
    near, far = await join("near"), await join("far")
    adder = Adder()
    await far.create_service("/add", ADD, adder)
    clients = [await called(near, "/add"), await called(near, "/add")]
    sums = await asyncio.gather(*(add(clients[i % 2], i) for i in range(1000)))
    assert sums == list(range(1000))
    assert len(adder.requests) == 1000
    assert len({request.id for request in adder.requests}) == 1000
    assert not near.drops
    assert not far.drops


async def test_large(join: Join) -> None:
    """Requests and answers of several megabytes go both ways."""
    near, far = await join("near"), await join("far")

    async def echo(request: Request) -> bytes:
        return request.payload

    await far.create_service("/echo", "pkg/srv/Echo", echo)
    client = await called(near, "/echo", "pkg/srv/Echo")
    payloads = [b"\0\1\0\0" + bytes([i]) * size for i, size in enumerate((0, 1, 2, 3, 5 << 20, 7, 3 << 20, 100_001))]
    answers = await asyncio.gather(*(client.call(Request(payload), 30) for payload in payloads))
    assert [bytes(answer) for answer in answers] == payloads


async def test_nobody(join: Join, monkeypatch: pytest.MonkeyPatch) -> None:
    """Where nobody serves a name a call fails after a moment, a shorter one when its time is over."""
    monkeypatch.setattr(module, "_NOBODY_S", 0.1)
    client = await (await join()).create_client("/add", ADD)
    for timeout_s in (30, 0.02, 0):
        with pytest.raises(NotServed, match="Service /add does not exist"):
            await add(client, 1, timeout_s=timeout_s)
    assert not await client.wait_available(0.02)


async def test_timeout(join: Join, caplog: pytest.LogCaptureFixture) -> None:
    """A call without an answer in time fails, and an answer that comes later is dropped."""
    near, far = await join("near"), await join("far")
    adder = Adder(open=False)
    await far.create_service("/add", ADD, adder)
    client = await called(near, "/add")
    with pytest.raises(CallTimeout):
        await add(client, 1, timeout_s=0.2)
    caplog.set_level(logging.DEBUG, "ropeway.dds")
    adder.open.set()
    await until(lambda: client.late == 1)
    assert "came late" in caplog.text
    assert await add(client, 2) == 2


async def test_server_leaves(join: Join) -> None:
    """Calls fail at once when their server leaves in mid-call; an answer given before still counts."""
    near, far = await join("near"), await join("far")
    adder = Adder(open=False)
    service = await far.create_service("/add", ADD, adder)
    client = await called(near, "/add")
    calls = [asyncio.create_task(add(client, i)) for i in range(3)]
    await until(lambda: len(adder.requests) == 3)
    await service.close()
    for call in calls:
        with pytest.raises(ProviderLost, match="/add was not answered"):
            await call
    assert not client.available
    adder.open.set()
    await far.create_service("/add", ADD, adder)
    assert await add(client, 4) == 4


async def test_server_is_replaced(join: Join) -> None:
    """A call to a new server does not fail because the one before it has just left."""
    near, far = await join("near"), await join("far")
    client = await near.create_client("/add", ADD)
    for number in range(10):
        service = await far.create_service("/add", ADD, Adder())
        assert await client.wait_available(PATIENCE_S)
        assert await add(client, number) == number
        await service.close()
        await until(lambda: not client.available)


async def test_one_of_two_servers_leaves(join: Join) -> None:
    """A call goes on while one of the servers that got it is left."""
    near, far, other = await join("near"), await join("far"), await join("other")
    slow, slower = Adder(open=False), Adder(open=False)
    first = await far.create_service("/add", ADD, slow)
    await other.create_service("/add", ADD, slower)
    client = await near.create_client("/add", ADD)
    await until(lambda: len(client._servers) == 2)
    call = asyncio.create_task(add(client, 7))
    await until(lambda: slow.requests and slower.requests)
    assert slow.requests[0].id == slower.requests[0].id
    await first.close()
    await until(lambda: len(client._servers) == 1)
    slower.open.set()
    assert await call == 7


async def test_server_process_ends(join: Join, domain: int) -> None:
    """A server process that takes its leave in mid-call fails the call."""
    near = await join("near")
    server = """
    async def main():
        graph = DdsGraph(int(sys.argv[1]), interface="lo")
        await graph.open()
        asked = asyncio.Event()
        async def wait(request):
            asked.set()
            await asyncio.sleep(3600)
        await graph.create_service("/add", "example_interfaces/srv/AddTwoInts", wait)
        await asked.wait()
        await graph.close()
    asyncio.run(main())
    """
    with process(server, domain):
        client = await called(near, "/add")
        with pytest.raises(ProviderLost):
            await add(client, 1)


async def test_cancelled(join: Join) -> None:
    """Who stops waiting is forgotten, and others are not touched."""
    near, far = await join("near"), await join("far")
    adder = Adder(open=False)
    await far.create_service("/add", ADD, adder)
    client = await called(near, "/add")
    call, other = asyncio.create_task(add(client, 1)), asyncio.create_task(add(client, 2))
    await until(lambda: len(adder.requests) == 2)
    await end(call)
    adder.open.set()
    assert await other == 2
    assert not client._calls


async def test_close(join: Join) -> None:
    """Closing fails what is under way, also what waits for a server, and later calls."""
    near, far = await join("near"), await join("far")
    adder = Adder(open=False)
    await far.create_service("/add", ADD, adder)
    client, lonely = await called(near, "/add"), await near.create_client("/nobody", ADD)
    calls = [asyncio.create_task(add(client, 1)), asyncio.create_task(add(lonely, 1))]
    await until(lambda: adder.requests)
    await asyncio.gather(client.close(), lonely.close())
    await client.close()
    for call in calls:
        with pytest.raises(GraphUnavailable):
            await call
    with pytest.raises(GraphUnavailable):
        await add(client, 1)
    assert not client.available
    assert not await client.wait_available(5)


async def test_graph_closes(join: Join) -> None:
    """Closing the graph fails what is under way."""
    near, far = await join("near"), await join("far")
    adder = Adder(open=False)
    await far.create_service("/add", ADD, adder)
    client = await called(near, "/add")
    call = asyncio.create_task(add(client, 1))
    await until(lambda: adder.requests)
    await near.close()
    with pytest.raises(GraphUnavailable):
        await call
    with pytest.raises(GraphUnavailable):
        await near.create_client("/add", ADD)


async def test_too_many(join: Join, monkeypatch: pytest.MonkeyPatch) -> None:
    """Above the limit calls are refused."""
    monkeypatch.setattr(module, "_CALLS_LIMIT", 2)
    near = await join()
    client = await near.create_client("/add", ADD)
    calls = [asyncio.create_task(add(client, 1)) for _ in range(2)]
    await asyncio.sleep(0)
    with pytest.raises(CallFailed, match="2 calls of /add are under way"):
        await add(client, 1)
    await end(*calls)


async def test_no_cdr(join: Join) -> None:
    """A request that is no CDR fails with the reason."""
    near, far = await join("near"), await join("far")
    await far.create_service("/add", ADD, Adder())
    client = await called(near, "/add")
    with pytest.raises(CallFailed, match="cannot be sent"):
        await client.call(Request(b"\xff\xff\xff\xff"))
    assert near.drops["/add", Undelivered.ENCODE] == 1


async def test_first_request_is_not_lost(join: Join) -> None:
    """A server that matches us late gets the request again, and runs it once."""
    near, far = await join("near"), await join("far")
    adder = Adder(open=False)
    await far.create_service("/add", ADD, adder)
    client = await called(near, "/add")
    call = asyncio.create_task(add(client, 1))
    await until(lambda: adder.requests)
    seq = client._seq
    sent: list[bytes] = []
    send = client._writer.send

    async def count(payload: bytes) -> Undelivered | None:
        sent.append(payload)
        return await send(payload)

    client._writer.send = count  # type: ignore[method-assign]
    await until(lambda: len(sent) >= 2)
    adder.open.set()
    assert await call == 1
    assert len(adder.requests) == 1
    assert {payload[4:20] for payload in sent} == {rpc.join(RequestHeader(client._id, seq), bytes(4))[4:]}


async def test_hostile_answers(join: Join) -> None:
    """Answers of other clients, other vendors and without sense are ignored, and those in another order are read."""
    near, far = await join("near", registry=TypeRegistry()), await join("far")
    adder = Adder(open=False)
    await far.create_service("/add", ADD, adder)
    client = await called(near, "/add")
    call = asyncio.create_task(add(client, 1))
    await until(lambda: adder.requests)
    mine = RequestHeader(client._id, client._seq)
    cyclone, fast = b"\x01\x10" + bytes(14), b"\x01\x0f" + bytes(14)

    def hear(payload: bytes, origin: bytes = cyclone) -> None:
        client.on_samples([Sample(payload, ADD, 0, origin, 0)])

    hear(rpc.join(mine, total(9)), fast)
    hear(b"\0\1\0\0")
    hear(rpc.join(RequestHeader(mine.client + 1, mine.seq), total(9)))
    hear(rpc.join(RequestHeader(mine.client, mine.seq + 1), total(9)))
    await asyncio.sleep(0.01)
    assert not call.done()
    big = mine.client.to_bytes(8, "big") + mine.seq.to_bytes(8, "big")
    hear(b"\0\1\0\0" + big + (33).to_bytes(8, "big"))
    assert await call == 33
    assert near.drops == {("/add", Undelivered.DECODE): 1}


async def test_unreadable_answer(join: Join) -> None:
    """An answer in the other byte order whose type is not known fails the call."""
    near, far = await join("near", registry=TypeRegistry()), await join("far")
    await far.create_service("/odd", "pkg/srv/Odd", Adder(open=False))
    client = await called(near, "/odd", "pkg/srv/Odd")
    call = asyncio.create_task(client.call(Request(addends(1))))
    await until(lambda: client._calls)
    big = client._id.to_bytes(8, "big") + client._seq.to_bytes(8, "big")
    client.on_samples([Sample(b"\0\1\0\0" + big + bytes(8), "", 0, b"\x01\x10" + bytes(14), 0)])
    with pytest.raises(CallFailed, match="the answer cannot be read"):
        await call


async def test_other_vendor(join: Join, monkeypatch: pytest.MonkeyPatch) -> None:
    """A service that only servers of another mapping offer is not called, and the error says what to do."""
    monkeypatch.setattr(module, "_NOBODY_S", 0.05)
    client = await (await join(fast=False)).create_client("/add", ADD)
    client._on_readers([(FAST,)])
    client._on_writers([(FAST,)])
    assert not client.available
    with pytest.raises(CallFailed, match=r"over Fast DDS only.*ros2 graph"):
        await add(client, 1)


class FakeHelper:
    """Calls and serves without a network."""

    def __init__(self, client: Client) -> None:
        self.client, self.made = client, 0

    def wake(self) -> None:
        """Have nothing to do: it is always awake."""

    async def create_client(self, service: str, type: str) -> Client:
        assert (service, type) == ("/add", ADD)
        self.made += 1
        return self.client

    async def create_service(self, service: str, type: str, handler: ServiceHandler) -> Service:
        raise NotImplementedError


async def test_helper(join: Join) -> None:
    """A helper makes the calls for which only servers of another mapping are there, with one client of its own."""
    near, far, elsewhere = await join("near"), await join("far"), await join("elsewhere")
    await far.create_service("/helped", ADD, Adder())
    near.helper = helper = FakeHelper(await called(elsewhere, "/helped"))
    client = await near.create_client("/add", ADD)
    client._on_readers([(FAST,)])
    client._on_writers([(FAST,)])
    assert client.available
    assert sorted(await asyncio.gather(*(add(client, i) for i in range(3)))) == [0, 1, 2]
    assert helper.made == 1
    await client.close()
    with pytest.raises(GraphUnavailable):
        await add(helper.client, 1)  # type: ignore[arg-type]


async def test_endpoints_of_helpers(join: Join, monkeypatch: pytest.MonkeyPatch) -> None:
    """Endpoints that helpers made are no servers."""
    monkeypatch.setattr(module, "_NOBODY_S", 0.05)
    client = await (await join()).create_client("/add", ADD)
    helper = MatchedEndpoint(b"\x01\x10" + bytes(14), helper=True)
    client._on_readers([(helper,)])
    client._on_writers([(helper,)])
    with pytest.raises(NotServed):
        await add(client, 1)


async def test_nodes_settle(join: Join, monkeypatch: pytest.MonkeyPatch) -> None:
    """A server that is no Ropeway gets its first request a moment after the match, and only once."""
    monkeypatch.setattr(module, "_SETTLE_S", 0.3)
    client = await (await join()).create_client("/add", ADD)
    sent: list[bytes] = []

    async def send(payload: bytes) -> None:
        sent.append(payload)

    client._writer.send = send  # type: ignore[method-assign]
    node = MatchedEndpoint(b"\x01\x10" + bytes(14), "serviceid=1", 10)
    client._on_readers([(node,)])
    client._on_writers([(node,)])
    assert client.available
    with pytest.raises(CallTimeout):
        await add(client, 1, timeout_s=0.1)
    assert not sent
    with pytest.raises(CallTimeout):
        await add(client, 1, timeout_s=1.0)
    assert len(sent) == 1
