"""When a graph begins to serve and to call Fast DDS nodes, and what its network sees of that."""

from __future__ import annotations

import asyncio

import pytest

from ropeway.errors import CallError, CallFailed
from ropeway.graph.calls import Request
from ropeway.networks.dds import DdsGraph
from ropeway.networks.dds.fastdds import FastRpc
from ropeway.networks.dds.fastdds import discovery as module
from ropeway.networks.dds.profile import make_profile
from ropeway.networks.dds.records import Joined, MatchedEndpoint
from tests.networks.dds.conftest import Join
from tests.support.services import ADD
from tests.support.until import PATIENCE_S, until

FAST = MatchedEndpoint(b"\x01\x0f" + bytes(14), "", 0)
NODE = Joined(b"\x01\x0f" + bytes(14))


async def echo(request: Request) -> bytes:
    return request.payload


def rpc_of(graph: DdsGraph, *, everyone: bool = True) -> FastRpc:
    """The part under test, which is to hear us though we are no Fast DDS node."""
    assert graph._fast is not None
    rpc = graph._fast._rpc
    rpc.helper._order["everyone"] = everyone
    return rpc


async def test_nothing_without_need(join: Join) -> None:
    """No process is started without a service, nor without a Fast DDS node."""
    topics, services = await join("topics"), await join("services")
    await services.create_service("/add", ADD, echo)
    topics._on_discovered([NODE])
    await asyncio.sleep(0.05)
    assert rpc_of(topics).helper.starts == rpc_of(services).helper.starts == 0


async def test_serves(join: Join, domain: int) -> None:
    """With the first Fast DDS node services are served to its kind, those that come later, too; until they close."""
    graph = await join("ours", gateway_id="ours")
    rpc, helper = rpc_of(graph), graph.helper
    assert helper is not None
    early = await helper.create_service("/early", ADD, echo)
    graph._on_discovered([NODE])
    await until(lambda: rpc.available)
    await helper.create_service("/late", ADD, echo)
    other = FastRpc("other", domain, make_profile("other", "lo"), everyone=True)
    assert await other.start()
    for name in ("/early", "/late"):
        client = await other.create_client(name, ADD)
        assert await client.wait_available(PATIENCE_S)
        assert await client.call(Request(b"\0\1\0\0" + name.encode())) == b"\0\1\0\0" + name.encode()
    client = await other.create_client("/early", ADD)
    assert await client.wait_available(PATIENCE_S)
    await early.close()
    await until(lambda: not client.available)
    await other.close()


async def test_unseen(join: Join, domain: int) -> None:
    """The process and its endpoints are nobody's to see, call or wait for, and nodes of Cyclone DDS are served once."""
    near, far = await join("near", gateway_id="near"), await join("far", gateway_id="far")
    asked = []

    async def ask(request: Request) -> bytes:
        asked.append(request)
        return request.payload

    await far.create_service("/add", ADD, ask)
    assert far._fast is not None
    far._fast.on_discovered([NODE])
    await until(lambda: rpc_of(far, everyone=False).available)
    client = await near.create_client("/add", ADD)
    assert await client.wait_available(PATIENCE_S)
    assert await client.call(Request(b"\0\1\0\0" + bytes(16))) == b"\0\1\0\0" + bytes(16)
    stray = FastRpc("stray", domain, make_profile("stray", "lo"), everyone=True)
    assert await stray.start()
    wrong = await stray.create_client("/add", ADD)
    await until(lambda: wrong._servers == 2)  # the endpoints of ``far`` for Cyclone DDS, and those for Fast DDS
    assert await client.call(Request(b"\0\1\0\0" + bytes(16))) == b"\0\1\0\0" + bytes(16)
    assert len(asked) == 2
    assert [len(info.servers) for name, info in near.services().items() if name == "/add"] == [1]
    assert near.settled
    assert far.settled
    with pytest.raises(CallError):
        await wrong.call(Request(b"\0\1\0\0" + bytes(64)), 0.5)
    await stray.close()
    assert len(asked) == 2


async def test_calls(join: Join) -> None:
    """A client whose servers are Fast DDS nodes alone starts the process as soon as it meets them."""
    graph = await join()
    client = await graph.create_client("/add", ADD)
    client._on_readers([(FAST,)])
    client._on_writers([(FAST,)])
    await until(lambda: rpc_of(graph).available)
    with pytest.raises(CallError):  # there is none in truth
        await client.call(Request(bytes(8)), 0.3)


async def test_unfit(join: Join, monkeypatch: pytest.MonkeyPatch) -> None:
    """Where the process is of no use, calls to Fast DDS nodes fail at once and say what to do; services go on."""
    monkeypatch.setattr("sys.executable", "/bin/false")
    graph, other = await join("graph"), await join("other")
    await graph.create_service("/mine", ADD, echo)
    graph._on_discovered([NODE])
    client = await graph.create_client("/add", ADD)
    client._on_readers([(FAST,)])
    client._on_writers([(FAST,)])
    for _ in range(2):
        with pytest.raises(CallFailed, match=r"over Fast DDS only.*its process ended at once.*use the ros2 graph"):
            await client.call(Request(bytes(8)))
    mine = await other.create_client("/mine", ADD)
    assert await mine.wait_available(PATIENCE_S)
    assert await mine.call(Request(b"\0\1\0\0\7")) == b"\0\1\0\0\7"


async def test_expects(join: Join, domain: int, monkeypatch: pytest.MonkeyPatch) -> None:
    """Services wait for endpoints that are known to be there, and for those that have left not for long."""
    graph = await join("ours")
    rpc = rpc_of(graph)
    assert graph._discovery is not None
    monkeypatch.setattr(graph._discovery, "guids", lambda prefix: [prefix + bytes(14)])
    assert graph.helper is not None
    await graph.helper.create_service("/add", ADD, echo)
    graph._on_discovered([NODE])
    await until(lambda: rpc.available)
    began = asyncio.get_running_loop().time()
    other = FastRpc("other", domain, make_profile("other", "lo"), everyone=True)
    assert await other.start()
    client = await other.create_client("/add", ADD)
    assert await client.wait_available(PATIENCE_S)
    assert asyncio.get_running_loop().time() - began > module._LEAST_S
    await other.close()
