"""client.services: services over a link, to plain servers and to gateways, played and real."""

from __future__ import annotations

import asyncio
import logging
from contextlib import AsyncExitStack
from typing import Any

import cbor2
import pytest

from ropeway.bridge.service import ServiceBridge
from ropeway.errors import (
    CallFailed,
    CallTimeout,
    GraphUnavailable,
    InvalidName,
    NotServed,
    ProviderLost,
    UnknownType,
)
from ropeway.graph.base import Delivery, Undelivered
from ropeway.graph.begun import Begun, Ended, Handler, into
from ropeway.graph.calls import Request, new_id
from ropeway.hub.hub import Hub
from ropeway.networks.memory.graph import MemoryGraph
from ropeway.networks.rosbridge.client import LinkState, RosbridgeGraph, services
from ropeway.networks.rosbridge.client.services import RemoteClient
from ropeway.networks.rosbridge.protocol import ops
from ropeway.networks.rosbridge.protocol.codec import decode_value
from ropeway.networks.rosbridge.protocol.dialect import ROSGW
from tests.networks.rosbridge.client.gateways import ScriptedGateway
from tests.support.messages import text
from tests.support.rosbridge import REGISTRY, Cloud, FakeServer
from tests.support.services import ADD, TEXT, Gate, add, addends, answer, total
from tests.support.until import PATIENCE_S, until

pytestmark = pytest.mark.jumping

REQUEST, RESPONSE = REGISTRY.codec(f"{ADD}_Request"), REGISTRY.codec(f"{ADD}_Response")


async def connect(stack: AsyncExitStack, url: str, **options: Any) -> RosbridgeGraph:
    settings = {"registry": REGISTRY, "ask_rosapi": False, "gateway_id": "us", **options}
    graph = RosbridgeGraph(url, **settings)
    await graph.open()
    stack.push_async_callback(graph.close)
    return graph


async def played(stack: AsyncExitStack, far: ScriptedGateway, **options: Any) -> RosbridgeGraph:
    """A graph behind a gateway that the test plays."""
    return await connect(stack, far.url, watch=options.pop("watch", False), **options)


def start(client: RemoteClient, a: int = 1, timeout_s: float = PATIENCE_S, **options: Any) -> asyncio.Task[bytes]:
    return asyncio.create_task(client.call(Request(addends(a), **options), timeout_s))


async def heard(fake: FakeServer, op: str, count: int = 1) -> list[dict[str, Any]]:
    await until(lambda: len(fake.ops(op)) >= count)
    return fake.ops(op)


def respond(fake: FakeServer, id: object, values: object, *, result: bool = True) -> None:
    fake.say({"op": "service_response", "service": "/add", "values": values, "result": result, "id": id})


# ── calling a plain server ─────────────────────────────────────────────────────────────────────────────────────────


async def test_calls_a_plain_server(stack: AsyncExitStack, fake: FakeServer) -> None:
    """A plain server gets a call as rosbridge knows it, and each answer goes to the call that has its id."""
    graph = await connect(stack, fake.url)
    client = await graph.create_client("/add", "example_interfaces/AddTwoInts", delivery=Delivery(encoding="zstd"))
    assert client.available is None
    assert await client.wait_available(0)
    calls = [start(client, i, 8) for i in range(3)]
    messages = await heard(fake, "call_service", 3)
    assert [m["id"] for m in messages] == [f"call_service:/add:{n}" for n in (1, 2, 3)]
    assert all(7 < m.pop("timeout") < 8 for m in messages)
    assert messages[1] == {
        "op": "call_service",
        "id": "call_service:/add:2",
        "service": "/add",
        "type": ADD,
        "args": {"a": 1, "b": 0},
    }
    for message in reversed(messages):
        respond(fake, message["id"], {"sum": message["args"]["a"] + 10})
    assert await asyncio.gather(*calls) == [total(10), total(11), total(12)]


@pytest.mark.parametrize(
    ("values", "error"),
    [
        ("Timeout exceeded while waiting for service response", CallTimeout),
        ("/add was not answered: its provider has left", ProviderLost),
        ("Service call exception: boom", CallFailed),
        (None, CallFailed),
        ({"sum": 1}, CallFailed),
    ],
)
async def test_failures_of_a_plain_server(
    stack: AsyncExitStack, fake: FakeServer, values: object, error: type[Exception]
) -> None:
    """The texts of a plain server become errors of our own kinds."""
    graph = await connect(stack, fake.url)
    call = start(await graph.create_client("/add", ADD))
    (message,) = await heard(fake, "call_service")
    respond(fake, message["id"], values, result=False)
    with pytest.raises(error) as caught:
        await call
    if isinstance(values, str):
        assert str(caught.value) == values


async def test_not_served(stack: AsyncExitStack, fake: FakeServer) -> None:
    """What a plain server says does not exist is asked for again for a second, then it is not served."""
    graph = await connect(stack, fake.url)
    client = await graph.create_client("/add", ADD)
    call = start(client)
    text = "Service /add does not exist"
    for count in (1, 2):
        respond(fake, (await heard(fake, "call_service", count))[-1]["id"], text, result=False)
    respond(fake, (await heard(fake, "call_service", 3))[-1]["id"], {"sum": 5})
    assert await call == total(5)
    call = start(client)
    count = 4
    while not call.done():
        if len(fake.ops("call_service")) >= count:
            respond(fake, fake.ops("call_service")[count - 1]["id"], text, result=False)
            count += 1
        await asyncio.sleep(0.01)
    with pytest.raises(NotServed, match="Service /add does not exist"):
        await call
    assert count < 12


async def test_unreadable_answer(stack: AsyncExitStack, fake: FakeServer) -> None:
    """An answer that is not of the type fails its call with the field, and nothing else."""
    graph = await connect(stack, fake.url)
    call = start(await graph.create_client("/add", ADD))
    (message,) = await heard(fake, "call_service")
    respond(fake, message["id"], {"sum": "many"})
    with pytest.raises(CallFailed, match="sum"):
        await call


async def test_late_answers(stack: AsyncExitStack, fake: FakeServer) -> None:
    """An answer for which nobody waits any more is counted; one that nobody asked for is complained of."""
    graph = await connect(stack, fake.url)
    client = await graph.create_client("/add", ADD)
    call = start(client, timeout_s=0.1)
    with pytest.raises(CallTimeout):
        await call
    cancelled = start(client)
    messages = await heard(fake, "call_service", 2)
    cancelled.cancel()
    with pytest.raises(asyncio.CancelledError):
        await cancelled
    for id in (*(m["id"] for m in messages), "invented"):
        respond(fake, id, {"sum": 1})
    fake.say({"op": "service_response", "service": "/odd", "values": {}, "result": True})
    await until(lambda: graph.drops["/add", Undelivered.LATE] == 3)
    assert graph.peer is not None
    await until(lambda: graph.peer and graph.peer.fault_log.counts["answer", "/odd"] == 1)
    assert not graph.calls.pending


async def test_link_is_lost(stack: AsyncExitStack, fake: FakeServer) -> None:
    """A call under way fails at once when the link goes; the next waits for the link within its time."""
    graph = await connect(stack, fake.url)
    client = await graph.create_client("/add", ADD)
    call = start(client, timeout_s=60)
    await heard(fake, "call_service")
    fake.connections[-1].abort("gone")
    with pytest.raises(ProviderLost, match=r"the link to ws://.* was lost"):
        await call
    waiting = start(client, timeout_s=20)
    respond(fake, (await heard(fake, "call_service", 2))[-1]["id"], {"sum": 3})
    assert await waiting == total(3)


async def test_link_is_down(stack: AsyncExitStack, fake: FakeServer) -> None:
    """A call with the link down says so when its time is over."""
    graph = await connect(stack, fake.url)
    client = await graph.create_client("/add", ADD)
    await fake.stop()
    await until(lambda: graph.state is not LinkState.CONNECTED)
    assert client.available is False
    assert not await client.wait_available(0.05)
    with pytest.raises(GraphUnavailable, match="the link is down"):
        await client.call(Request(addends(1)), 0.1)


async def test_closing(stack: AsyncExitStack, fake: FakeServer) -> None:
    """A client that closes, by itself or with its graph, fails its calls, and takes no more."""
    graph = await connect(stack, fake.url)
    first, second = await graph.create_client("/add", ADD), await graph.create_client("/add", ADD)
    calls = [start(first), start(second)]
    await heard(fake, "call_service", 2)
    await first.close()
    await first.close()
    with pytest.raises(GraphUnavailable, match="closed in mid-call"):
        await calls[0]
    await graph.close()
    with pytest.raises(GraphUnavailable, match="closed in mid-call"):
        await calls[1]
    with pytest.raises(GraphUnavailable, match="is closed"):
        await second.call(Request(addends(1)))
    assert second.available is False
    with pytest.raises(GraphUnavailable):
        await graph.create_service("/add", ADD, add)


async def test_serves_on_rosgw(stack: AsyncExitStack, fake: FakeServer) -> None:
    """A rosgw server is told the configured encoding, and is answered in the one that its call names."""
    graph = await connect(stack, fake.url)
    assert graph.peer is not None
    graph.peer.speak(ROSGW)
    service = await graph.create_service("/add", ADD, add, delivery=Delivery(encoding="zip"))
    (told,) = await heard(fake, "advertise_service")
    assert told["compression"] == "zip"
    assert service.encoding == "none"  # nobody has asked for another yet
    fake.say({"op": "call_service", "id": "1", "service": "/add", "args": {"a": 2, "b": 3}, "compression": "zip"})
    await until(lambda: fake.binaries)
    answer = cbor2.loads(fake.binaries[0])
    assert (answer["op"], answer["id"], answer["compression"]) == ("service_response", "1", "zip")
    assert decode_value(answer["values"], "zip", RESPONSE) == total(5)
    assert service.encoding == "zip"
    odd = await graph.create_service("/odd", ADD, add, delivery=Delivery(encoding="zstd"))
    assert "compression" not in (await heard(fake, "advertise_service", 2))[-1]
    assert odd.encoding == "none"
    client = await graph.create_client("/far", ADD, delivery=Delivery(encoding="zip"))
    assert client.encoding == "none"


async def test_rosgw_is_called_one_by_one(stack: AsyncExitStack, fake: FakeServer) -> None:
    """A rosgw server, which loses a call that comes during another, gets one at a time."""
    graph = await connect(stack, fake.url)
    assert graph.peer is not None
    graph.peer.speak(ROSGW)
    client = await graph.create_client("/add", ADD)
    calls = [start(client, i) for i in range(3)]
    for count in (1, 2, 3):
        messages = await heard(fake, "call_service", count)
        assert len(messages) == count
        assert "compression" not in messages[-1]
        respond(fake, messages[-1]["id"], {"sum": messages[-1]["args"]["a"]})
    assert sorted(await asyncio.gather(*calls)) == [total(0), total(1), total(2)]
    held = start(client)
    await heard(fake, "call_service", 4)
    with pytest.raises(CallTimeout):
        await client.call(Request(addends(1)), 0.1)
    held.cancel()


# ── serving on a plain server ──────────────────────────────────────────────────────────────────────────────────────


async def test_serves_on_a_plain_server(stack: AsyncExitStack, fake: FakeServer) -> None:
    """A service is advertised with its type and no encoding, answers calls by id, and is withdrawn when it closes."""
    graph = await connect(stack, fake.url)
    service = await graph.create_service("/add", ADD, add, delivery=Delivery(encoding="zstd"))
    (advertised,) = await heard(fake, "advertise_service")
    assert advertised == {"op": "advertise_service", "id": service.id, "service": "/add", "type": ADD}
    fake.say({"op": "call_service", "service": "/add", "args": {"a": 1, "b": 2}, "id": "x"})
    fake.say({"op": "call_service", "service": "/add", "args": [3, 4], "id": None})
    fake.say({"op": "call_service", "service": "/add#old"})
    fake.say({"op": "call_service", "service": "/none", "id": 7})
    answers = await heard(fake, "service_response", 4)
    assert sorted(answers, key=str) == sorted(
        [
            {"op": "service_response", "service": "/add", "values": {"sum": 3}, "result": True, "id": "x"},
            {"op": "service_response", "service": "/add", "values": {"sum": 7}, "result": True},
            {"op": "service_response", "service": "/add#old", "values": {"sum": 0}, "result": True, "id": "old"},
            {
                "op": "service_response",
                "service": "/none",
                "values": "Service /none does not exist",
                "result": False,
                "id": 7,
            },
        ],
        key=str,
    )
    await service.close()
    await service.close()
    (withdrawn,) = await heard(fake, "unadvertise_service")
    assert withdrawn == {"op": "unadvertise_service", "id": service.id, "service": "/add"}


async def test_failures_of_ours(stack: AsyncExitStack, fake: FakeServer, caplog: pytest.LogCaptureFixture) -> None:
    """A call that fails here is answered with the reason, whatever it is that failed."""
    errors: list[Exception] = [CallFailed("/add", "no"), KeyError("key"), ValueError()]

    async def handler(request: Request) -> bytes:
        raise errors.pop(0)

    graph = await connect(stack, fake.url)
    await graph.create_service("/add", ADD, handler)
    for count, args in enumerate(({}, {}, {}, {"a": "x"}, 5), 1):
        fake.say({"op": "call_service", "service": "/add", "args": args, "id": str(count)})
        await heard(fake, "service_response", count)
    answers = {m["id"]: m["values"] for m in fake.ops("service_response") if not m["result"]}
    assert list(answers.values())[:3] == ["no", "'key'", "ValueError"]
    assert "field a" in answers["4"]
    assert "neither an object" in answers["5"]
    assert caplog.text.count("the handler of /add failed") == 2


async def test_an_answer_of_another_type(stack: AsyncExitStack, fake: FakeServer) -> None:
    """An answer of ours that is not of the type fails the call."""

    async def handler(request: Request) -> bytes:
        return b"\0\1\0\0"

    graph = await connect(stack, fake.url)
    await graph.create_service("/add", ADD, handler)
    fake.say({"op": "call_service", "service": "/add", "args": {}, "id": "1"})
    (failed,) = await heard(fake, "service_response")
    assert failed["result"] is False
    assert "AddTwoInts" in failed["values"]


async def test_rosgw_wants_an_object(stack: AsyncExitStack, fake: FakeServer) -> None:
    """A rosgw server gets an empty object with a failure: a text would end its connection."""

    async def handler(request: Request) -> bytes:
        raise CallFailed("/add", "no")

    graph = await connect(stack, fake.url)
    await graph.create_service("/add", ADD, handler)
    assert graph.peer is not None
    graph.peer.speak(ROSGW)
    fake.say({"op": "call_service", "service": "/add", "args": {}, "id": "1"})
    (failed,) = await heard(fake, "service_response")
    assert (failed["values"], failed["result"]) == ({}, False)


async def test_advertised_again(stack: AsyncExitStack, fake: FakeServer) -> None:
    """When the link comes back the service is advertised again; what was under way when it went is given up."""
    gate = Gate()
    graph = await connect(stack, fake.url)
    await graph.create_service("/add", ADD, gate)
    fake.say({"op": "call_service", "service": "/add", "args": {"a": 1}, "id": "1"})
    await until(lambda: gate.seen)
    fake.connections[-1].abort("gone")
    await heard(fake, "advertise_service", 2)
    gate.open.set()
    fake.say({"op": "call_service", "service": "/add", "args": {"a": 2}, "id": "2"})
    assert [m["id"] for m in await heard(fake, "service_response")] == ["2"]


async def test_busy(stack: AsyncExitStack, fake: FakeServer, monkeypatch: pytest.MonkeyPatch) -> None:
    """More calls at a time than a service works at are refused, and those under way are answered."""
    monkeypatch.setattr(services, "CALLS_LIMIT", 2)
    gate = Gate()
    graph = await connect(stack, fake.url)
    await graph.create_service("/add", ADD, gate)
    for id in range(3):
        fake.say({"op": "call_service", "service": "/add", "args": {"a": id}, "id": id})
    (refused,) = await heard(fake, "service_response")
    assert (refused["id"], refused["values"]) == (2, "/add is busy with 2 calls")
    gate.open.set()
    assert len(await heard(fake, "service_response", 3)) == 3


async def test_unknown_type(stack: AsyncExitStack, fake: FakeServer, caplog: pytest.LogCaptureFixture) -> None:
    """A service whose type nobody knows cannot be served on a plain server, now or when it is back."""
    graph = await connect(stack, fake.url)
    with pytest.raises(UnknownType, match="my_msgs/srv/Own"):
        await graph.create_service("/own", "my_msgs/srv/Own", add)
    assert not graph.services()
    await fake.stop()
    await until(lambda: graph.peer is None)
    service = await graph.create_service("/own", "my_msgs/srv/Own", add)
    with pytest.raises(InvalidName, match="already"):
        await graph.create_service("/own", "my_msgs/srv/Own", add)
    with caplog.at_level(logging.WARNING):
        await fake.start()
        await until(lambda: service.refused)
    assert "my_msgs/srv/Own" in service.refused
    client = await graph.create_client("/own", "my_msgs/srv/Own")
    await until(lambda: graph.state is LinkState.CONNECTED)
    with pytest.raises(CallFailed, match="not known"):
        await client.call(Request(addends(1)))


# ── gateways ───────────────────────────────────────────────────────────────────────────────────────────────────────


async def test_calls_a_gateway(stack: AsyncExitStack, far: ScriptedGateway) -> None:
    """A gateway gets the call's own id, its way, who calls and how to answer; its answer is read as it is encoded."""
    graph = await played(stack, far)
    client = await graph.create_client("/add", ADD, delivery=Delivery(encoding="rawzip"))
    id = new_id()
    call = start(client, 5, id=id, via=("a", "b"), caller="/node")
    (op,) = await far.hear("call_service")
    assert op.ropeway == {"call": id.hex(), "via": ["a", "b", "us"], "caller": "/node", "encoding": "rawzip"}
    assert op.compression == "rawzip"
    assert decode_value(op.args, op.compression, None) == addends(5)
    answer = ops.ServiceResponse(id=op.id, service=op.service, values=None, result=True)
    far.peer.send_op(answer, payload=total(5), field="values", encoding="zstd")
    assert await call == total(5)


@pytest.mark.parametrize(
    ("word", "error"),
    [
        ("timeout", CallTimeout),
        ("lost", ProviderLost),
        ("denied", CallFailed),
        ("failed", CallFailed),
        ("invented", CallFailed),
        (7, CallFailed),
    ],
)
async def test_failures_of_a_gateway(
    stack: AsyncExitStack, far: ScriptedGateway, word: object, error: type[Exception]
) -> None:
    """The word that a gateway sends with a failure tells which kind it is."""
    graph = await played(stack, far)
    call = start(await graph.create_client("/add", ADD))
    (op,) = await far.hear("call_service")
    note = {"error": word}
    far.peer.send_op(ops.ServiceResponse(id=op.id, service="/add", values="so it is", result=False, ropeway=note))
    with pytest.raises(error) as caught:
        await call
    assert type(caught.value) is error
    if error is CallFailed:
        assert str(caught.value) == "so it is"


async def test_waits_for_hello(stack: AsyncExitStack, far: ScriptedGateway) -> None:
    """A gateway is called once it has said hello, so that it is known how."""
    far.greets = False
    graph = await played(stack, far)
    client = await graph.create_client("/own", "my_msgs/srv/Own")
    call = start(client)
    await until(lambda: far.peers)
    with pytest.raises(GraphUnavailable, match="link is down"):
        await client.call(Request(addends(1)), 0.05)
    far.peer.hello("scripted", "scripted")
    assert (await far.hear("call_service"))[0].args == addends(1)
    call.cancel()


async def test_serves_on_a_gateway(stack: AsyncExitStack, far: ScriptedGateway) -> None:
    """A gateway is told the type with its definition and how to encode requests, and asks for the handler's answer."""
    requests: list[Request] = []

    async def handler(request: Request) -> bytes:
        requests.append(request)
        return total(9)

    graph = await played(stack, far)
    await graph.create_service("/add", ADD, handler, delivery=Delivery(encoding="cbor"))
    (op,) = await far.hear("advertise_service")
    assert (op.service, op.type, op.compression) == ("/add", ADD, "cbor")
    assert op.ropeway["type_hash"].startswith("RIHS01_")
    assert "int64 sum" in op.ropeway["definition"]
    note = {"call": "ab" * 16, "via": ["them"], "caller": "somebody"}
    call = ops.CallService(id="1", service="/add", args=None, timeout=3.0, ropeway=note)
    far.peer.send_op(call, payload=addends(4), encoding="zip", codec=REQUEST)
    (reply,) = await far.hear("service_response")
    assert (reply.id, reply.result, reply.compression) == ("1", True, "cbor")
    assert decode_value(reply.values, reply.compression, RESPONSE) == total(9)
    (request,) = requests
    assert request == requests[0]
    assert (request.payload, request.id, request.via) == (addends(4), b"\xab" * 16, ("them",))
    assert (request.caller, request.timeout_s) == ("somebody", 3.0)


async def test_the_same_call_runs_once(stack: AsyncExitStack, far: ScriptedGateway) -> None:
    """A call that comes again, over another link or once more, gets the answer of the first and does not run."""
    other = ScriptedGateway(REGISTRY)
    stack.push_async_callback(other.stop)
    await other.start()
    gate, local = Gate(), MemoryGraph("calls that run once")
    await local.open()
    stack.push_async_callback(local.close)
    hub = Hub(local, gateway_id="us")
    await hub.view("provider").create_service("/add", ADD, gate)
    for gateway in (far, other):
        bridge = ServiceBridge(hub.view("route"), await played(stack, gateway), "/add", "/add", ADD)
        await bridge.start()
        stack.push_async_callback(bridge.close)
        await gateway.hear("advertise_service")

    def send(gateway: ScriptedGateway, id: str, call: str) -> None:
        op = ops.CallService(id=id, service="/add", args=None, ropeway={"call": call * 32})
        gateway.peer.send_op(op, payload=addends(1))

    send(far, "1", "a")
    send(other, "2", "a")
    await until(lambda: gate.seen)
    gate.open.set()
    replies = [*await far.hear("service_response"), *await other.hear("service_response")]
    send(far, "3", "a")
    send(far, "4", "b")
    replies += (await far.hear("service_response", 3))[1:]
    assert {r.id for r in replies} == {"1", "2", "3", "4"}
    assert all(r.result and r.values == total(1) for r in replies)
    assert len(gate.seen) == 2


async def test_refused(stack: AsyncExitStack, far: ScriptedGateway, caplog: pytest.LogCaptureFixture) -> None:
    """A name that somebody else serves is told with the reason, once, and so is its grant."""
    graph = await played(stack, far)
    service = await graph.create_service("/add", ADD, add)
    states: list[str] = []
    caplog.set_level(logging.INFO)
    service.on_state(states.append)
    await far.hear("advertise_service")
    for _ in range(2):
        far.peer.send({"op": "refused", "service": "/add", "reason": "robot1 serves it"})
        await until(lambda: service.refused)
        far.peer.send({"op": "granted", "service": "/add"})
        await until(lambda: not service.refused)
    far.peer.send({"op": "refused", "service": "/other", "reason": "x"})
    far.peer.send({"op": "refused", "service": "/add"})
    await until(lambda: len(states) == 6)
    assert states == ["", "robot1 serves it", "", "robot1 serves it", "", "it was refused"]
    assert caplog.text.count("service /add was refused: robot1 serves it") == 1


async def test_mirrors_services(stack: AsyncExitStack, far: ScriptedGateway) -> None:
    """What a gateway tells of services decides whether one is available, and a call waits for it."""
    graph = RosbridgeGraph(far.url, registry=REGISTRY)
    stack.push_async_callback(graph.close)
    opening = asyncio.create_task(graph.open())
    await far.hear_control("watch")
    far.show()
    await opening
    changes = graph.changes()
    client = await graph.create_client("/add", ADD)
    assert client.available is False
    with pytest.raises(NotServed):
        await client.call(Request(addends(1)), 0.05)
    call = start(client)
    failing = (await far.hear("call_service", 2))[-1]
    note = {"error": "not_served"}
    far.peer.send_op(ops.ServiceResponse(id=failing.id, service="/add", values="", result=False, ropeway=note))
    far.show(services={"/add": {"types": [ADD], "servers": [{"node": "/n", "since_ns": 5, "gid": "zz"}]}})
    assert await client.wait_available(PATIENCE_S)
    assert client.available is True
    again = (await far.hear("call_service", 3))[-1]
    answer = ops.ServiceResponse(id=again.id, service="/add", values=None, result=True)
    far.peer.send_op(answer, payload=total(1), field="values")
    assert await call == total(1)
    event = await anext(changes)
    assert str(event) == f"{far.url}: node /n offers service /add ({ADD})"
    (provider,) = graph.services()["/add"].servers
    assert (provider.node, provider.since_ns, provider.gid) == ("/n", 5, b"")
    far.show(services={"/add": None}, actions={"/x": 3})
    await until(lambda: not graph.services())
    assert not (await anext(changes)).discovered


async def test_asks_rosapi_for_services(stack: AsyncExitStack, fake: FakeServer) -> None:
    """A plain server is asked for its services and actions once somebody wants to know them."""
    answers: dict[str, dict[str, Any]] = {
        "/rosapi/topics": {"topics": [], "types": []},
        "/rosapi/nodes": {"nodes": []},
        "/rosapi/services": {"services": ["/add", 5]},
        "/rosapi/service_type": {"type": ADD},
        "/rosapi/action_servers": {"action_servers": ["/fly"]},
        "/rosapi/action_type": {"type": ""},
    }

    async def play() -> None:
        answered = 0
        while True:
            calls = fake.ops("call_service")
            for call in calls[answered:]:
                values = answers[call["service"]]
                fake.say({"op": "service_response", "id": call["id"], "values": values, "result": True, "service": ""})
            answered = len(calls)
            await asyncio.sleep(0.01)

    playing = asyncio.create_task(play())
    graph = await connect(stack, fake.url, ask_rosapi=True)
    assert graph.services() == {}
    assert not [c for c in fake.ops("call_service") if "service" in c["service"]]
    await until(lambda: graph.services())
    assert graph.services()["/add"].types == (ADD,)
    assert graph.actions()["/fly"].types == ()
    client = await graph.create_client("/add", ADD)
    assert client.available is None
    playing.cancel()


# ── a real server ──────────────────────────────────────────────────────────────────────────────────────────────────


@pytest.mark.parametrize("plain", [False, True])
@pytest.mark.parametrize("encoding", ["auto", "none", "cbor", "cbor-raw", "zip", "rawzip", "zstd", "png"])
async def test_through_a_server(stack: AsyncExitStack, cloud: Cloud, encoding: str, plain: bool) -> None:
    """Requests and answers, small and large, come through a server in every encoding, byte for byte."""
    url = f"ws://127.0.0.1:{cloud.port}"
    near, far = await connect(stack, url, plain=plain), await connect(stack, url, gateway_id="them", plain=plain)

    async def echo(request: Request) -> bytes:
        size = request.payload[4]
        return answer(request.payload[8 : 8 + 4 * size].decode("ascii", "replace")[:20] + "y" * 1_500_000)

    delivery = Delivery(encoding=encoding)
    await far.create_service("/x", TEXT, echo, delivery=delivery)
    client = await near.create_client("/x", TEXT, delivery=delivery)
    assert await client.wait_available(PATIENCE_S)
    got = await client.call(Request(text("x" * 1_200_000)), 20)
    assert got.endswith(b"y" * 100 + b"\0")
    assert len(got) > 1_500_000


async def test_a_thousand_calls(stack: AsyncExitStack, cloud: Cloud) -> None:
    """1,000 calls at a time are each answered once, with their own answer."""
    url = f"ws://127.0.0.1:{cloud.port}"
    near, far = await connect(stack, url), await connect(stack, url, gateway_id="them")
    await far.create_service("/add", ADD, add)
    client = await near.create_client("/add", ADD)
    assert await client.wait_available(PATIENCE_S)
    answers = await asyncio.gather(*(client.call(Request(addends(i)), 30) for i in range(1000)))
    assert answers == [total(i) for i in range(1000)]


async def test_takes_over(stack: AsyncExitStack, cloud: Cloud) -> None:
    """Of two that serve one name the second is told who does, and takes over when the first leaves."""
    url = f"ws://127.0.0.1:{cloud.port}"
    first, second = await connect(stack, url, gateway_id="one"), await connect(stack, url, gateway_id="two")
    await first.create_service("/add", ADD, add)
    await until(lambda: second.services().get("/add"))
    waiting = await second.create_service("/add", ADD, add)
    await until(lambda: waiting.refused)
    await first.close()
    await until(lambda: not waiting.refused)
    third = await connect(stack, url, gateway_id="three")
    client = await third.create_client("/add", ADD)
    assert await client.call(Request(addends(2))) == total(2)


async def test_server_restarts(stack: AsyncExitStack, cloud: Cloud) -> None:
    """After the server was away, the service is served and called again; what was under way failed at once."""
    url = f"ws://127.0.0.1:{cloud.port}"
    gate = Gate()
    near, far = await connect(stack, url), await connect(stack, url, gateway_id="them")
    await far.create_service("/add", ADD, gate)
    client = await near.create_client("/add", ADD)
    call = start(client, timeout_s=60)
    await until(lambda: gate.seen)
    await cloud.stop()
    with pytest.raises(ProviderLost, match="the gateway stops"):
        await call
    gate.open.set()
    await cloud.start()
    assert await client.call(Request(addends(7)), 20) == total(7)


# ── calls that are begun without a task ────────────────────────────────────────────────────────────────────────────


async def begun(client: RemoteClient, far: ScriptedGateway, timeout_s: float = PATIENCE_S) -> asyncio.Future[bytes]:
    """Begin a call at once; gives its end."""
    ended: asyncio.Future[bytes] = asyncio.get_running_loop().create_future()
    await until(lambda: client._calls.peer is not None)
    assert client.begin(Request(addends(5)), timeout_s, into(ended)) is not None
    await far.hear("call_service")
    return ended


def reply_to(far: ScriptedGateway, number: int = 0) -> None:
    """Answer a call."""
    op = [op for op in far.heard if isinstance(op, ops.CallService)][number]
    reply = ops.ServiceResponse(id=op.id, service=op.service, values=None, result=True)
    far.peer.send_op(reply, payload=total(5), field="values")


async def test_begun_call(stack: AsyncExitStack, far: ScriptedGateway) -> None:
    """A call that is begun at once ends with its answer, once; another answer counts as late."""
    graph = await played(stack, far)
    client = await graph.create_client("/add", ADD)
    ended = await begun(client, far)
    reply_to(far)
    reply_to(far)
    assert await ended == total(5)
    await until(lambda: graph.drops["/add", Undelivered.LATE] == 1)
    assert not client._under_way.busy
    assert not client._calls.pending


async def test_begun_call_is_not_served(stack: AsyncExitStack, far: ScriptedGateway) -> None:
    """A call that is begun at once and not served is made again, as others are."""
    graph = await played(stack, far)
    ended = await begun(await graph.create_client("/add", ADD), far)
    (op,) = await far.hear("call_service")
    note = {"error": "not_served"}
    far.peer.send_op(ops.ServiceResponse(id=op.id, service="/add", values="no", result=False, ropeway=note))
    await far.hear("call_service", 2)
    reply_to(far, 1)
    assert await ended == total(5)


async def test_begun_call_ends_with_the_link(stack: AsyncExitStack, far: ScriptedGateway) -> None:
    """A call that is begun at once fails when its link is lost."""
    graph = await played(stack, far)
    ended = await begun(await graph.create_client("/add", ADD), far)
    far.peer.connection.abort("gone")
    with pytest.raises(ProviderLost, match="was lost"):
        await ended


async def test_begun_call_takes_too_long(stack: AsyncExitStack, far: ScriptedGateway) -> None:
    """A call that is begun at once fails when its time is over."""
    graph = await played(stack, far)
    client = await graph.create_client("/add", ADD)
    with pytest.raises(CallTimeout):
        await (await begun(client, far, 0.05))
    assert not client._calls.pending


async def test_begun_call_of_a_closed_client(stack: AsyncExitStack, far: ScriptedGateway) -> None:
    """A call that is begun at once fails when its client is closed, which then begins no other."""
    graph = await played(stack, far)
    client = await graph.create_client("/add", ADD)
    ended = await begun(client, far)
    await client.close()
    with pytest.raises(GraphUnavailable, match="closed"):
        await ended
    assert client.begin(Request(addends(5)), PATIENCE_S, lambda _: None) is None


async def test_begun_answers(stack: AsyncExitStack, far: ScriptedGateway) -> None:
    """A service whose handler begins at once answers each call once, and gives up what is under way with the link."""
    graph = await played(stack, far)
    calls: list[Begun] = []

    async def wait(request: Request) -> bytes:
        raise AssertionError("it begins at once")

    def begin(request: Request, ended: Ended) -> Begun:
        calls.append(Begun(ended))
        return calls[-1]

    await graph.create_service("/add", ADD, Handler(wait, begin))
    await far.hear("advertise_service")
    ends: tuple[bytes | Exception, ...] = (total(5), CallFailed("/add", "so it is"), ZeroDivisionError("boom"))
    for i, how in enumerate(ends):
        far.peer.send_op(ops.CallService(id=f"{i}", service="/add", args=None), payload=addends(i), field="args")
        await until(lambda i=i: len(calls) == i + 1)
        calls[i].end(how)
    replies = await far.hear("service_response", 3)
    assert [(reply.id, reply.result) for reply in replies] == [("0", True), ("1", False), ("2", False)]
    assert [reply.values for reply in replies[1:]] == ["so it is", "boom"]
    far.peer.send_op(ops.CallService(id="3", service="/add", args=None), payload=addends(3), field="args")
    await until(lambda: len(calls) == 4)
    far.peer.connection.abort("gone")
    await until(lambda: calls[3].over)
