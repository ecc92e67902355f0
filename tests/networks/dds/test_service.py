"""Services that we serve over DDS."""

from __future__ import annotations

import asyncio
import logging

import pytest

from ropeway import aio
from ropeway.errors import CallFailed, GraphUnavailable, InvalidName, InvalidTypeName, ProviderLost
from ropeway.graph.base import Sample, Undelivered
from ropeway.graph.calls import Client, Request, Service, ServiceHandler
from ropeway.networks.dds import DdsGraph, rpc
from ropeway.networks.dds import service as module
from ropeway.networks.dds.rpc import RequestHeader
from ropeway.types import TypeRegistry
from tests.support.services import ADD, addends, total
from tests.support.until import PATIENCE_S, until

from .calls import TRIGGER, Adder, add, called
from .conftest import Join

CYCLONE, FAST = b"\x01\x10" + bytes(14), b"\x01\x0f" + bytes(14)
EMPTY = b"\0\1\0\0\0"


def asked(seq: int, payload: bytes, origin: bytes = CYCLONE, client: int = 7) -> Sample:
    """A request as it arrives."""
    return Sample(rpc.join(RequestHeader(client, seq), payload), ADD, 0, origin, 0)


async def test_requests(join: Join) -> None:
    """A handler gets the payload, the node that asks, and an id of its own for each call."""
    near, far = await join("near", namespace="/robot"), await join("far")
    adder = Adder()
    await far.create_service("/add", ADD, adder)
    client = await called(near, "/add")
    await until(lambda: "/robot/near" in far.nodes())
    await add(client, 1, 2)
    await add(client, 1, 2)
    first, second = adder.requests
    assert (first.payload, first.caller, first.timeout_s) == (addends(1, 2), "/robot/near", None)
    assert len(first.id) == 16
    assert first.id != second.id


async def test_slow_handlers(join: Join) -> None:
    """A slow request delays no other."""
    near, far = await join("near"), await join("far")
    gate = asyncio.Event()

    async def handle(request: Request) -> bytes:
        if request.payload == addends(1):
            await gate.wait()
        return total(0)

    await far.create_service("/add", ADD, handle)
    client = await called(near, "/add")
    slow = asyncio.create_task(add(client, 1))
    await add(client, 2)
    assert not slow.done()
    gate.set()
    await slow


async def test_failures(join: Join, caplog: pytest.LogCaptureFixture) -> None:
    """A request that fails is answered with the default response, with the reason where the type has room for it."""
    near, far = await join("near"), await join("far")
    registry = TypeRegistry()

    async def fail(request: Request) -> bytes:
        raise CallFailed("/x", "the arm is not homed")

    await far.create_service("/trigger", TRIGGER, fail)
    await far.create_service("/add", ADD, fail)
    await far.create_service("/set", "rcl_interfaces/srv/SetParametersAtomically", fail)
    client = await called(near, "/trigger", TRIGGER)
    response = registry.codec(f"{TRIGGER}_Response").decode(await client.call(Request(EMPTY)))
    assert response == {"success": False, "message": "the arm is not homed"}
    assert await add(await called(near, "/add"), 1) == 0
    assert caplog.text.count("answered with an empty response: the arm is not homed") == 2


async def test_handler_raises(join: Join, caplog: pytest.LogCaptureFixture) -> None:
    """A handler that fails by mistake, or gives no CDR, is counted and costs this call only."""
    near, far = await join("near"), await join("far")

    async def handle(request: Request) -> bytes:
        if request.payload == addends(1):
            raise ValueError("oh")
        return b"" if request.payload == addends(2) else total(3)

    await far.create_service("/add", ADD, handle)
    client = await called(near, "/add")
    assert [await add(client, i) for i in (1, 2, 3)] == [0, 0, 3]
    assert far.drops == {("/add", Undelivered.CALLBACK): 1, ("/add", Undelivered.ENCODE): 1}
    assert "the handler of /add failed" in caplog.text


async def test_unknown_type(join: Join, caplog: pytest.LogCaptureFixture) -> None:
    """Without a definition a failed request is counted, and says so."""
    near, far = await join("near"), await join("far")

    async def fail(request: Request) -> bytes:
        raise CallFailed("/odd", "no")

    await far.create_service("/odd", "pkg/srv/Odd", fail)
    client = await called(near, "/odd", "pkg/srv/Odd")
    call = asyncio.create_task(client.call(Request(EMPTY)))
    await until(lambda: far.drops["/odd", Undelivered.ENCODE])
    assert "cannot be answered" in caplog.text
    await near.close()
    with pytest.raises(GraphUnavailable):
        await call


async def test_once(join: Join) -> None:
    """A request that comes twice runs once; the same number of another client is another request."""
    far = await join("far")
    adder = Adder()
    service = await far.create_service("/add", ADD, adder)
    service.on_samples([asked(1, addends(1)), asked(1, addends(1)), asked(2, addends(1))])
    service.on_samples([asked(1, addends(1), client=8), asked(1, addends(1), CYCLONE[:-1] + b"\1")])
    await until(lambda: len(adder.requests) == 4)
    assert len({request.id for request in adder.requests}) == 4


async def test_memory_is_bounded(join: Join, monkeypatch: pytest.MonkeyPatch) -> None:
    """Of the requests that were seen the newest are remembered."""
    monkeypatch.setattr(module, "_SEEN_LIMIT", 10)
    monkeypatch.setattr(module, "_MATCH_S", 0.01)
    service = await (await join()).create_service("/add", ADD, Adder())
    service.on_samples([asked(i, addends(1)) for i in range(1, 50)])
    assert len(service._seen) == 10
    await until(lambda: not service._serving.tasks)
    assert not service._paces


async def test_too_many(join: Join, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture) -> None:
    """Above the limit requests are dropped and counted, and said once."""
    monkeypatch.setattr(module, "_RUNNING_LIMIT", 3)
    far = await join("far")
    adder = Adder(open=False)
    service = await far.create_service("/add", ADD, adder)
    service.on_samples([asked(i, addends(1)) for i in range(1, 9)])
    await until(lambda: len(adder.requests) == 3)
    assert far.drops["/add", Undelivered.BACKLOG] == 5
    assert caplog.text.count("3 requests are under way") == 1


async def test_hostile_requests(join: Join) -> None:
    """Bytes that are no request are counted, and requests in the other byte order are read."""
    far = await join("far", registry=TypeRegistry())
    adder = Adder()
    service = await far.create_service("/add", ADD, adder)
    service.on_samples([Sample(payload, ADD, 0, CYCLONE, 0) for payload in (b"", b"\0\1\0\0", b"\xff" * 100)])
    big = b"".join(number.to_bytes(8, "big") for number in (7, 1, 20, 22))
    short = b"\0\0\0\0" + big[:15] + b"\2" + big[16:20]
    service.on_samples([Sample(payload, ADD, 0, CYCLONE, 0) for payload in (b"\0\1\0\0" + big, short)])
    await until(lambda: adder.requests and far.drops["/add", Undelivered.DECODE] == 4)
    assert [request.payload for request in adder.requests] == [addends(20, 22)]


async def test_other_vendors(join: Join, caplog: pytest.LogCaptureFixture) -> None:
    """Requests of another mapping are ignored, counted, and said once."""
    adder = Adder()
    service = await (await join(fast=False)).create_service("/add", ADD, adder)
    service.on_samples([asked(i, addends(1), FAST) for i in range(1, 4)])
    assert service.ignored == 3
    await asyncio.sleep(0)  # one that was taken would be carried out now
    assert not adder.requests
    assert caplog.text.count("a client asks over Fast DDS") == 1


class Served:
    """What a helper serves."""

    closed = False

    def __init__(self, service: str, type: str) -> None:
        self.service, self.type = service, type

    async def close(self) -> None:
        self.closed = True


class FakeHelper:
    """Serves without a network."""

    def __init__(self, *, broken: bool = False) -> None:
        self.broken = broken
        self.served: list[tuple[Served, ServiceHandler]] = []

    def wake(self) -> None:
        raise NotImplementedError

    async def create_client(self, service: str, type: str) -> Client:
        raise NotImplementedError

    async def create_service(self, service: str, type: str, handler: ServiceHandler) -> Service:
        if self.broken:
            raise GraphUnavailable("helper", "cannot start")
        served = Served(service, type)
        self.served.append((served, handler))
        return served


async def test_helper(join: Join, caplog: pytest.LogCaptureFixture) -> None:
    """A helper serves the same name, its failed requests are answered in the same way, and it ends with the service."""
    helper = FakeHelper()
    graph = await join(helper=helper)

    async def fail(request: Request) -> bytes:
        raise CallFailed("/add", "no")

    service = await graph.create_service("/add", ADD, fail)
    service.on_samples([asked(1, addends(1), FAST)])
    ((served, handler),) = helper.served
    assert (served.service, served.type) == ("/add", ADD)
    assert await handler(Request(addends(1))) == total(0)
    await service.close()
    assert served.closed
    assert "asks over Fast DDS" not in caplog.text


async def test_helper_fails(join: Join, caplog: pytest.LogCaptureFixture) -> None:
    """Where the helper cannot serve, nodes of Cyclone DDS are served all the same, and the log says so."""
    near, far = await join("near"), await join("far", helper=FakeHelper(broken=True))
    await far.create_service("/add", ADD, Adder())
    assert await add(await called(near, "/add"), 3) == 3
    assert "/add serves nodes of Cyclone DDS only: helper: cannot start" in caplog.text


async def test_client_without_a_reader(
    join: Join, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    """A client that reads no answers is given up on after a while, and counted."""
    monkeypatch.setattr(module, "_MATCH_S", 0.05)
    near, far = await join("near"), await join("far")
    adder = Adder()
    service = await far.create_service("/add", ADD, adder)
    client = await called(near, "/add")
    await near.participant.delete(client._reader)
    await until(lambda: not service._callers and service._writers)
    await client._writer.send(asked(1, addends(1)).payload)
    await until(lambda: far.drops["/add", Undelivered.WRITE])
    assert "reads no answers" in caplog.text
    service.on_samples([asked(1, addends(1), CYCLONE)])
    await until(lambda: len(adder.requests) == 2 and not service._serving.tasks)
    assert far.drops["/add", Undelivered.WRITE] == 1


async def test_close(join: Join) -> None:
    """Closing ends the handlers, the service is listed no more, and nothing is served."""
    near, far = await join("near"), await join("far")
    adder = Adder(open=False)
    service = await far.create_service("/add", ADD, adder)
    client = await called(near, "/add")
    call = asyncio.create_task(add(client, 1))
    await until(lambda: adder.requests)
    await asyncio.gather(service.close(), service.close())
    assert adder.cancelled == 1
    with pytest.raises(ProviderLost):
        await call
    service.on_samples([asked(1, addends(1))])
    assert len(adder.requests) == 1
    await until(lambda: not near.services()["/add"].servers)
    await client.close()
    await until(lambda: not near.services() and not far.services())


async def test_names(join: Join) -> None:
    """Names and types are checked, and a type may be written in short."""
    graph = await join()
    with pytest.raises(InvalidName):
        await graph.create_service("/no//name", ADD, Adder())
    for type in ("nonsense", "std_msgs/msg/String"):
        with pytest.raises(InvalidTypeName):
            await graph.create_client("/add", type)
    service = await graph.create_service("add", "example_interfaces/AddTwoInts", Adder())
    assert (service.service, service.type) == ("/add", ADD)
    with pytest.raises(GraphUnavailable):
        await DdsGraph(3).create_service("/add", ADD, Adder())


async def test_own_gateway(join: Join) -> None:
    """Two processes of one gateway serve and call each other."""
    near, far = await join("near", gateway_id="gw"), await join("far", gateway_id="gw")
    await far.create_service("/add", ADD, Adder())
    assert await add(await called(near, "/add"), 3) == 3


async def test_a_graph_does_not_call_itself(join: Join) -> None:
    """A graph's own service is no server of its clients."""
    graph = await join()
    await graph.create_service("/add", ADD, Adder())
    client = await graph.create_client("/add", ADD)
    assert not await client.wait_available(0.2)


async def test_listed(join: Join) -> None:
    """A service is listed with who serves and calls it, the gateway and since when; those who come and go are told."""
    near, far = await join("near", gateway_id="one"), await join("far", gateway_id="two")
    changes = near.changes()
    service = await far.create_service("/add", ADD, Adder())
    await called(near, "/add")
    await until(lambda: near.nodes()["/far"].services and far.services()["/add"].clients)
    await until(lambda: far.nodes()["/near"].clients)
    info = near.services()["/add"]
    (server,), (client,) = info.servers, info.clients
    assert (info.type, server.node, server.gateway, server.local) == (ADD, "/far", "two", False)
    assert (client.node, client.gateway, client.local) == ("/near", "one", True)
    assert server.since_ns > 1_700_000_000 * 10**9
    (mirrored,) = far.services()["/add"].servers
    assert mirrored.local
    assert mirrored.since_ns == server.since_ns
    assert near.nodes()["/far"].services == (("/add", ADD),)
    assert far.nodes()["/near"].clients == (("/add", ADD),)
    await service.close()
    told: list[str] = []
    async with aio.timeout(PATIENCE_S):
        async for event in changes:
            told.append(str(event).partition(": ")[2])
            if "no longer" in told[-1]:
                break
    assert told[-2:] == [f"node /far offers service /add ({ADD})", f"node /far no longer offers service /add ({ADD})"]


async def test_log_is_quiet(join: Join, caplog: pytest.LogCaptureFixture) -> None:
    """The same trouble is told once, and in detail for those who look."""
    caplog.set_level(logging.DEBUG, "ropeway.dds")
    near, far = await join("near"), await join("far")

    async def fail(request: Request) -> bytes:
        raise CallFailed("/add", "no")

    await far.create_service("/add", ADD, fail)
    client = await called(near, "/add")
    for i in range(3):
        await add(client, i)
    lines = [record.levelname for record in caplog.records if "empty response" in record.getMessage()]
    assert lines == ["WARNING", "DEBUG", "DEBUG"]
