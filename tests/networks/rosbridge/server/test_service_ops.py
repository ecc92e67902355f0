"""server.service_ops: conversations with a plain rosbridge client about services, text by text."""

from __future__ import annotations

import asyncio
import json
from collections.abc import Awaitable, Callable
from typing import Any

import cbor2
import pytest

from ropeway.errors import CallError, CallFailed, ProviderLost
from ropeway.graph.calls import Client as GraphClient
from ropeway.graph.calls import Request
from ropeway.networks.rosbridge.protocol.codec import decode_value
from tests.support.place import Place
from tests.support.services import ADD, add, addends, total
from tests.support.until import PATIENCE_S, until
from tests.support.websocket import BINARY, Client

pytestmark = pytest.mark.jumping

TRIGGER, EMPTY = "std_srvs/srv/Trigger", "std_srvs/srv/Empty"
CALL = '{"op":"call_service","id":"call_service:/add:1","service":"/add","type":"example_interfaces/AddTwoInts",'


async def serve(
    place: Place, name: str = "/add", type: str = ADD, handler: Callable[[Request], Awaitable[bytes]] = add
) -> None:
    """The robot serves a service."""
    await place.robot.create_service(name, type, handler)


async def calling(place: Place, name: str = "/add", type: str = ADD) -> GraphClient:
    """A client of the robot for a service of the server's client, once it is there."""
    client = await place.robot.create_client(name, type)
    assert await client.wait_available(PATIENCE_S)
    return client


# ── calling ────────────────────────────────────────────────────────────────────────────────────────────────────────


async def test_answers_byte_for_byte(place: Place) -> None:
    """An answer has op, service, values, result and id in this order, as rosbridge sends it."""
    await serve(place)
    client = await place.client()
    client.send(CALL + '"args":{"a":2,"b":3}}')
    got = await client.receive()
    assert got.text
    assert got.data == (
        b'{"op":"service_response","service":"/add","values":{"sum":5},"result":true,"id":"call_service:/add:1"}'
    )
    await client.nothing()


@pytest.mark.parametrize(
    ("args", "sum"),
    [
        ('"args":{"a":2,"b":3}', 5),
        ('"args":{"b":3}', 3),
        ('"args":[2,3]', 5),
        ('"args":[2]', 2),
        ('"args":[2,3,4,"more"]', 5),
        ('"args":{}', 0),
        ('"args":[]', 0),
        ('"args":null', 0),
        ('"args":""', 0),
        ('"args":"text"', 0),
        ('"args":7', 0),
        ('"args":true', 0),
        ('"args":{"a":1},"compression":"png"', 1),
        ('"args":{"a":1},"type":"no type at all"', 1),
        ('"args":{"a":1},"type":7', 1),
        ('"args":{"a":1},"timeout":null,"fragment_size":null', 1),
        ('"args":{"a":1},"timeout":-1', 1),
        ('"args":{"a":1},"timeout":0.0,"fragment_size":2147483647', 1),
        ('"x":1', 0),
    ],
)
async def test_arguments(place: Place, args: str, sum: int) -> None:
    """Arguments are an object, or a list in the order of the fields; what is left out, or is neither, has defaults."""
    await serve(place)
    client = await place.client()
    client.send('{"op":"call_service","service":"/add",' + args + "}")
    assert await client.json() == {
        "op": "service_response",
        "service": "/add",
        "values": {"sum": sum},
        "result": True,
    }


@pytest.mark.parametrize("id", ["text", 7, 1.5, "", True, ["a", {"b": None}], "\u2603", 2**53 + 1])
async def test_ids(place: Place, id: Any) -> None:
    """An id comes back as it was sent, whatever it is."""
    await serve(place)
    client = await place.client()
    client.send({"op": "call_service", "service": "/add", "id": id})
    got = await client.json()
    assert "id" in got
    assert got["id"] == id
    assert type(got["id"]) is type(id)


@pytest.mark.parametrize(
    ("service", "more", "id"),
    [
        ("add", "", ""),
        ("add", ',"id":null', ""),
        ("/add#old", ',"id":null', ',"id":"old"'),
        ("/add#old", "", ',"id":"old"'),
        ("add#old", ',"id":"new"', ',"id":"new"'),
        ("/add#", "", ',"id":""'),
    ],
)
async def test_names(place: Place, service: str, more: str, id: str) -> None:
    """A service is named as the client did; the end of an old client's name its end is the id if there is no other."""
    await serve(place)
    client = await place.client()
    client.send('{"op":"call_service","service":"' + service + '"' + more + "}")
    wanted = '{"op":"service_response","service":"' + service + '","values":{"sum":0},"result":true' + id + "}"
    assert (await client.receive()).data.decode() == wanted


async def test_fails(place: Place) -> None:
    """A call that fails is answered with false and the text, rosbridge's where it has one."""

    async def fail(request: Request) -> bytes:
        raise CallFailed("/fails", "the arm is \u201cstuck\u201d")

    async def hang(request: Request) -> bytes:
        await asyncio.Event().wait()
        raise AssertionError

    await serve(place, "/add")
    await serve(place, "/fails", handler=fail)
    await serve(place, "/hangs", handler=hang)
    await serve(place, "/strange", "strange_msgs/srv/Unknown")
    client = await place.client()
    for message, text in [
        ('"service":"/nobody"', "Service /nobody does not exist"),
        ('"service":"nobody#x","id":1', "Service /nobody does not exist"),
        ('"service":"/nobody","type":"std_srvs/Empty"', "Service /nobody does not exist"),
        ('"service":"/nobody","type":"std_srvs/Unheard"', "Service /nobody does not exist"),
        ('"service":"/nobody","type":"std_msgs/msg/String"', "Service /nobody does not exist"),
        ('"service":"/fails"', "the arm is \u201cstuck\u201d"),
        ('"service":"/hangs","timeout":0.05', "Timeout exceeded while waiting for service response"),
        (
            '"service":"/add","args":{"c":1}',
            "Message type example_interfaces/AddTwoInts_Request does not have a field c",
        ),
        (
            '"service":"/add","args":{"a":"one"}',
            "example_interfaces/AddTwoInts_Request message requires a int64 for field a, but got a <class 'str'>",
        ),
        (
            '"service":"/add","args":{"a":1.0}',
            "example_interfaces/AddTwoInts_Request message requires a int64 for field a, but got a <class 'float'>",
        ),
    ]:
        client.send('{"op":"call_service",' + message + "}")
        got = await client.receive()
        assert got.data.isascii()
        assert got.json["values"] == text
        assert got.json["result"] is False
        assert list(got.json)[:4] == ["op", "service", "values", "result"]
    client.send({"op": "call_service", "service": "/strange", "id": "s"})
    assert "strange_msgs/srv/Unknown" in (await client.json())["values"]
    assert place.complaints == {}


@pytest.mark.parametrize(
    ("message", "answer"),
    [
        ('"id":"a"', '"service":"","values":"call_service: Expected a service field but none was found."'),
        (
            '"id":"a","service":5',
            '"service":"","values":"call_service: Expected field service to be one of (<class \'str\'>,).'
            ' Invalid value: 5"',
        ),
        (
            '"id":"a","service":"/add","timeout":"long"',
            '"service":"/add","values":"call_service: Expected field timeout to be one of (<class \'int\'>,).'
            ' Invalid value: long"',
        ),
        ('"id":"a","service":"/a b"', '"service":"/a b"'),
        ('"id":"a","service":""', '"service":""'),
    ],
)
async def test_bad_calls(place: Place, message: str, answer: str) -> None:
    """A call that cannot be understood is answered, too, if it says what it is about."""
    client = await place.client()
    client.send('{"op":"call_service",' + message + "}")
    got = (await client.receive()).data.decode()
    assert got.startswith('{"op":"service_response",' + answer)
    assert got.endswith(',"result":false,"id":"a"}')
    await client.nothing()


async def test_bad_call_of_nobody(place: Place) -> None:
    """A call without a name and an id is counted, and cannot be answered."""
    client = await place.client()
    client.send('{"op":"call_service"}')
    client.send('{"op":"call_service","service":null}')
    await client.nothing()
    assert place.complaints == {"operation": 2}


async def test_hidden_service(place: Place) -> None:
    """A service of an action can be called, without an id and with no arguments, as roslibjs 2 does."""
    asked: list[Request] = []

    async def cancel(request: Request) -> bytes:
        asked.append(request)
        return place.registry.codec("action_msgs/srv/CancelGoal_Response").from_json({})

    await serve(place, "/fib/_action/cancel_goal", "action_msgs/srv/CancelGoal", cancel)
    client = await place.client()
    client.send({"op": "call_service", "service": "/fib/_action/cancel_goal", "args": {}})
    assert await client.json() == {
        "op": "service_response",
        "service": "/fib/_action/cancel_goal",
        "values": {"return_code": 0, "goals_canceling": []},
        "result": True,
    }
    assert len(asked) == 1


async def test_out_of_order(place: Place) -> None:
    """A slow call delays no other, not even of the same client; messages go on too."""
    gate = asyncio.Event()

    async def slow(request: Request) -> bytes:
        await gate.wait()
        return total(1)

    await serve(place, "/slow", handler=slow)
    await serve(place)
    client = await place.client()
    client.send({"op": "call_service", "service": "/slow", "id": "slow"})
    client.send({"op": "call_service", "service": "/add", "id": "fast"})
    assert (await client.json())["id"] == "fast"
    gate.set()
    assert (await client.json())["id"] == "slow"


async def test_thousand_calls(place: Place) -> None:
    """A thousand calls at a time are each answered once, with their own answer; what is above 1,024 is refused."""
    gate = asyncio.Event()

    async def slow(request: Request) -> bytes:
        await gate.wait()
        return await add(request)

    await serve(place, handler=slow)
    client = await place.client()
    for number in range(1100):
        client.send({"op": "call_service", "service": "/add", "id": number, "args": [number, 1]})
    refused = [await client.json() for _ in range(1100 - 1024)]
    assert {r["result"] for r in refused} == {False}
    assert {r["values"] for r in refused} == {"too many calls: 1024 of this client are under way"}
    gate.set()
    answers = {r["id"]: r["values"]["sum"] for r in [await client.json() for _ in range(1024)]}
    assert answers == {number: number + 1 for number in range(1100) if number not in {r["id"] for r in refused}}
    await client.nothing()


async def test_caller_leaves(place: Place) -> None:
    """The calls of a client that leaves are given up."""
    begun, ended = asyncio.Event(), asyncio.Event()

    async def slow(request: Request) -> bytes:
        begun.set()
        try:
            await asyncio.Event().wait()
        finally:
            ended.set()
        raise AssertionError

    provider = await place.client()
    provider.send({"op": "advertise_service", "service": "/remote", "type": ADD})
    await provider.done()
    await serve(place, "/slow", handler=slow)
    client = await place.client()
    client.send({"op": "call_service", "service": "/slow"})
    client.send({"op": "call_service", "service": "/remote"})
    request = await provider.json()
    await begun.wait()
    client.abort()
    await asyncio.wait_for(ended.wait(), PATIENCE_S)
    await until(lambda: len(place.server.sessions) == 1)
    provider.send({"op": "service_response", "service": "/remote", "id": request["id"], "values": {}, "result": True})
    await provider.nothing()
    assert place.complaints == {"service_response": 1}


async def test_provider_on_the_network_leaves(place: Place) -> None:
    """A provider on the network that vanishes fails its calls at once."""
    begun = asyncio.Event()

    async def slow(request: Request) -> bytes:
        begun.set()
        await asyncio.Event().wait()
        raise AssertionError

    service = await place.robot.create_service("/slow", ADD, slow)
    client = await place.client()
    client.send({"op": "call_service", "service": "/slow", "id": 1, "timeout": 0})
    await begun.wait()
    await service.close()
    got = await client.json(2)
    assert (got["result"], got["id"]) == (False, 1)


async def test_large_answer_in_fragments(place: Place) -> None:
    """A client that asks for fragments gets a long answer in fragments, and another one whole."""

    async def long(request: Request) -> bytes:
        return place.registry.codec(TRIGGER + "_Response").from_json({"success": True, "message": "x" * 5000})

    await serve(place, "/long", TRIGGER, long)
    client = await place.client()
    client.send({"op": "call_service", "service": "/long", "id": "f", "fragment_size": 1000})
    pieces = [await client.json() for _ in range(6)]
    assert [p["num"] for p in pieces] == list(range(6))
    assert json.loads("".join(p["data"] for p in pieces))["values"]["message"] == "x" * 5000
    client.send({"op": "call_service", "service": "/long"})
    assert (await client.json())["values"]["message"] == "x" * 5000


async def test_binary_frames(place: Place) -> None:
    """Calls as ROS# sends them, JSON in binary continuation frames of 1024 bytes, are answered as text."""
    await serve(place)
    client = await place.client()
    call = {"op": "call_service", "id": None, "service": "/add", "args": {"a": 1, "b": 2}, "fragment_size": 2147483647}
    client.send_pieces(BINARY, json.dumps({**call, "compression": "none", "type": "x" * 3000}).encode(), 1024)
    got = await client.receive()
    assert got.text
    assert got.json == {"op": "service_response", "service": "/add", "values": {"sum": 3}, "result": True}


# ── serving ────────────────────────────────────────────────────────────────────────────────────────────────────────


async def offer(place: Place, name: str = "/add", type: str = "example_interfaces/AddTwoInts", **more: Any) -> Client:
    """A client that serves a service."""
    client = await place.client()
    client.send({"op": "advertise_service", "service": name, "type": type, **more})
    await client.done()
    return client


@pytest.mark.parametrize("encoding", ["cbor", "cbor-raw", "zip", "rawzip"])
async def test_named_encodings(place: Place, encoding: str) -> None:
    """A peer that names an encoding for a call, or for a service of its own, gets responses and requests in it."""
    request, response = place.registry.codec(f"{ADD}_Request"), place.registry.codec(f"{ADD}_Response")
    await serve(place)
    client = await place.client()
    message = json.loads(CALL + '"args":{"a":2,"b":3}}')
    client.send({**message, "id": "svc:" + "5" * 32, "compression": encoding})
    got = await client.receive()
    answer = cbor2.loads(got.data)
    assert (got.text, answer["result"], answer["compression"]) == (False, True, encoding)
    assert decode_value(answer["values"], encoding, response) == total(5)
    provider = await offer(place, "/far", compression=encoding)
    caller = await calling(place, "/far")
    pending = asyncio.ensure_future(caller.call(Request(addends(20, 1))))
    got = await provider.receive()
    asked = cbor2.loads(got.data)
    assert (got.text, asked["compression"]) == (False, encoding)
    assert decode_value(asked["args"], encoding, request) == addends(20, 1)
    provider.send(
        {"op": "service_response", "service": "/far", "id": asked["id"], "result": True, "values": {"sum": 7}}
    )
    assert await pending == total(7)


@pytest.mark.parametrize("type", ["example_interfaces/AddTwoInts", ADD, "/example_interfaces//AddTwoInts"])
async def test_serves(place: Place, type: str) -> None:
    """A call from the network goes to the client with numbered ids, and its answer back."""
    provider = await offer(place, type=type, id="advertise_service:/add:1")
    caller = await calling(place)
    for number in (1, 2):
        call = asyncio.ensure_future(caller.call(Request(addends(20, number))))
        assert (await provider.receive()).data.decode() == (
            f'{{"op":"call_service","id":"service_request:/add:{number}","service":"/add",'
            f'"args":{{"a":20,"b":{number}}}}}'
        )
        provider.send(
            {
                "op": "service_response",
                "service": "/add",
                "id": f"service_request:/add:{number}",
                "values": {"sum": 20 + number},
                "result": True,
            }
        )
        assert await call == total(20 + number)
    await provider.nothing()
    assert place.complaints == {}


async def test_serves_relative_name(place: Place) -> None:
    """A service of a relative name is named to its client as the client did."""
    provider = await offer(place, "add")
    caller = await calling(place)
    call = asyncio.ensure_future(caller.call(Request(addends(1, 2))))
    request = await provider.json()
    assert (request["id"], request["service"]) == ("service_request:add:1", "add")
    provider.send(
        {"op": "service_response", "service": "add", "id": request["id"], "values": {"sum": 9}, "result": True}
    )
    assert await call == total(9)


async def test_one_client_to_another(place: Place) -> None:
    """A client calls what another serves, and what it serves itself."""
    provider = await offer(place)
    caller = await place.client()
    for client in (caller, provider):
        client.send({"op": "call_service", "service": "/add", "args": [4, 5], "id": "c"})
        request = await provider.json()
        assert request["args"] == {"a": 4, "b": 5}
        answer = {"op": "service_response", "service": "/add", "id": request["id"], "values": {"sum": 9}}
        provider.send({**answer, "result": True})
        assert (await client.json())["values"] == {"sum": 9}


@pytest.mark.parametrize(
    ("response", "text", "complaints"),
    [
        ({"values": "no hands", "result": False}, "no hands", {}),
        ({"values": "no hands", "result": True}, "no hands", {}),
        ({"result": False}, "/add failed, and does not say why", {}),
        ({"values": None, "result": False}, "/add failed, and does not say why", {}),
        (
            {"result": True},
            "Expected a values field but none was found.",
            {"service_response": 1},
        ),
        (
            {"values": {"sum": "x"}, "result": True},
            "example_interfaces/AddTwoInts_Response message requires a int64 for field sum, but got a <class 'str'>",
            {"service_response": 1},
        ),
        (
            {"values": [[]], "result": True},
            "example_interfaces/AddTwoInts_Response message requires a int64 for field sum, but got a <class 'list'>",
            {"service_response": 1},
        ),
        (
            {"values": {"sum": 1}},
            "service_response: Expected a result field but none was found.",
            {"operation": 1},
        ),
    ],
)
async def test_failed_answers(place: Place, response: dict[str, Any], text: str, complaints: dict[str, int]) -> None:
    """An answer that says no, or cannot be used, fails the call at once with its text."""
    provider = await offer(place)
    caller = await place.client()
    caller.send({"op": "call_service", "service": "/add", "id": "c", "timeout": 0})
    request = await provider.json()
    provider.send({"op": "service_response", "service": "/add", "id": request["id"], **response})
    assert await caller.json(2) == {
        "op": "service_response",
        "service": "/add",
        "values": text,
        "result": False,
        "id": "c",
    }
    assert place.complaints == complaints


async def test_answer_with_a_false_result(place: Place) -> None:
    """A response counts whatever result says: a ROS 2 service has no other way to say no."""
    provider = await offer(place, "/set", "std_srvs/SetBool")
    caller = await place.client()
    caller.send({"op": "call_service", "service": "/set"})
    request = await provider.json()
    values = {"success": False, "message": "no hands"}
    answer = {"op": "service_response", "service": "/set", "id": request["id"], "values": values}
    provider.send({**answer, "result": False})
    assert await caller.json() == {"op": "service_response", "service": "/set", "values": values, "result": True}


async def test_failed_answer_on_the_network(place: Place) -> None:
    """On the network, too, a call that the client refuses fails at once."""
    provider = await offer(place)
    caller = await calling(place)
    call = asyncio.ensure_future(caller.call(Request(addends(1))))
    request = await provider.json()
    provider.send(
        {"op": "service_response", "service": "/add", "id": request["id"], "values": "no hands", "result": False}
    )
    with pytest.raises(CallFailed, match="no hands"):
        await call


async def test_empty_answer(place: Place) -> None:
    """An answer without values does where the response has no fields."""
    provider = await offer(place, "/empty", "std_srvs/Empty")
    caller = await place.client()
    caller.send({"op": "call_service", "service": "/empty"})
    request = await provider.json()
    assert request["args"] == {}
    provider.send({"op": "service_response", "service": "/empty", "id": request["id"], "result": True})
    assert (await caller.json())["values"] == {}


async def test_strange_answers(place: Place) -> None:
    """An answer that nobody waits for is counted and does no harm; a second one is one of these."""
    provider = await offer(place)
    caller = await place.client()
    caller.send({"op": "call_service", "service": "/add", "id": "c", "timeout": 0})
    request = await provider.json()
    good = {"op": "service_response", "service": "/add", "id": request["id"], "values": {"sum": 3}, "result": True}
    for bad in (
        {**good, "id": "service_request:/add:2"},
        {**good, "id": 1},
        {**good, "id": None},
        {k: v for k, v in good.items() if k != "id"},
        {**good, "service": "/other"},
    ):
        provider.send(bad)
    provider.send(good)
    provider.send(good)
    assert (await caller.json())["values"] == {"sum": 3}
    await provider.nothing()
    await caller.nothing()
    assert place.complaints == {"service_response": 6}


async def test_advertised_twice(place: Place) -> None:
    """A service that its client advertises again begins anew: what was asked fails, and ids count from one."""
    provider = await offer(place)
    caller = await place.client()
    caller.send({"op": "call_service", "service": "/add", "id": "old", "timeout": 0})
    assert (await provider.json())["id"] == "service_request:/add:1"
    provider.send({"op": "advertise_service", "service": "/add", "type": ADD})
    got = await caller.json(2)
    assert (got["id"], got["result"]) == ("old", False)
    caller.send({"op": "call_service", "service": "/add", "id": "new"})
    request = await provider.json()
    assert request["id"] == "service_request:/add:1"
    provider.send(
        {"op": "service_response", "service": "/add", "id": request["id"], "values": {"sum": 1}, "result": True}
    )
    assert (await caller.json())["values"] == {"sum": 1}


async def test_advertised_with_another_type(place: Place) -> None:
    """A service may be advertised again with another type."""
    provider = await offer(place)
    provider.send({"op": "advertise_service", "service": "/add", "type": "std_srvs/Trigger"})
    await provider.done()
    assert place.robot.services()["/add"].types == (TRIGGER,)
    caller = await place.client()
    caller.send({"op": "call_service", "service": "/add"})
    request = await provider.json()
    answer = {"op": "service_response", "service": "/add", "id": request["id"], "result": True}
    provider.send({**answer, "values": {"success": True, "message": "m"}})
    assert (await caller.json())["values"] == {"success": True, "message": "m"}


async def test_unadvertise(place: Place) -> None:
    """A service that is withdrawn fails what was asked at once and is gone; what was never there is counted."""
    provider = await offer(place)
    caller = await place.client()
    caller.send({"op": "call_service", "service": "/add", "id": 1, "timeout": 0})
    await provider.json()
    provider.send({"op": "unadvertise_service", "service": "/add"})
    assert await caller.json(2) == {
        "op": "service_response",
        "service": "/add",
        "values": "/add was not answered: its provider has withdrawn it",
        "result": False,
        "id": 1,
    }
    await until(lambda: not place.robot.services()["/add"].servers)
    caller.send({"op": "call_service", "service": "/add", "id": 2})
    assert (await caller.json())["values"] == "Service /add does not exist"
    provider.send({"op": "unadvertise_service", "service": "/add"})
    await provider.nothing()
    assert place.complaints == {"unadvertise_service": 1}


async def test_provider_leaves(place: Place) -> None:
    """The services of a client that leaves are withdrawn, and what was asked fails at once, here and on the network."""
    provider = await offer(place)
    caller, robot = await place.client(), await calling(place)
    caller.send({"op": "call_service", "service": "/add", "id": 1, "timeout": 0})
    call = asyncio.ensure_future(robot.call(Request(addends(1)), 30))
    await provider.json()
    await provider.json()
    provider.abort()
    got = await caller.json(2)
    assert (got["values"], got["result"]) == ("/add was not answered: its provider has left", False)
    with pytest.raises(ProviderLost):
        await asyncio.wait_for(call, 2)
    again = await offer(place)
    caller.send({"op": "call_service", "service": "/add", "id": 2})
    assert (await again.json())["id"] == "service_request:/add:1"


async def test_two_providers(place: Place) -> None:
    """Of two clients that offer one service the first has it; the second is told, and takes over when it leaves."""
    first = await offer(place)
    second = await place.client(path="/?status=1")
    second.send({"op": "advertise_service", "service": "/add", "type": ADD})
    told = await second.json()
    assert told["level"] == "error"
    assert "Service /add is already offered by 127.0.0.1:" in told["msg"]
    assert told["msg"].endswith("; this one takes over when it leaves")
    caller = await place.client()
    caller.send({"op": "call_service", "service": "/add", "id": 1})
    assert (await first.json())["op"] == "call_service"
    first.abort()
    assert (await caller.json())["result"] is False
    told = await second.json()
    assert (told["op"], told["level"]) == ("status", "info")
    caller.send({"op": "call_service", "service": "/add", "id": 2})
    assert (await second.json())["op"] == "call_service"


@pytest.mark.parametrize(
    ("op", "kind"),
    [
        ('"service":"/s"', "operation"),
        ('"type":"std_srvs/Empty"', "operation"),
        ('"service":"/s","type":"std_srvs/Unheard"', "advertise_service"),
        ('"service":"/s","type":"std_msgs/msg/String"', "advertise_service"),
        ('"service":"/s","type":"std_srvs/action/Unheard"', "advertise_service"),
        ('"service":"/s","type":"nonsense"', "advertise_service"),
        ('"service":"/s s","type":"std_srvs/Empty"', "advertise_service"),
    ],
)
async def test_bad_advertisements(place: Place, op: str, kind: str) -> None:
    """A service that cannot be served is counted and not offered."""
    client = await place.client()
    client.send('{"op":"advertise_service",' + op + "}")
    await client.nothing()
    assert place.complaints == {kind: 1}
    assert place.robot.services() == {}
    assert place.session.services.offered == {}


async def test_many_requests_to_one_provider(place: Place) -> None:
    """A client that does not answer is not asked more than 1,024 times at once, by however many callers."""
    provider = await offer(place)
    robot = await calling(place)
    calls = [asyncio.ensure_future(robot.call(Request(addends(n)), 30)) for n in range(1030)]
    for _ in range(1024):
        await provider.json()
    done, _ = await asyncio.wait(calls, timeout=0.1)
    assert len(done) == 6
    for call in done:
        with pytest.raises(CallError, match="too many calls"):
            await call
    provider.abort()
    results = await asyncio.gather(*calls, return_exceptions=True)
    assert all(isinstance(r, CallError) for r in results)


async def test_status_of_services(place: Place) -> None:
    """The status of a client tells what it serves."""
    provider = await offer(place)
    session = place.session
    caller = await place.client()
    caller.send({"op": "call_service", "service": "/add"})
    await provider.json()
    assert session.status()["services"] == [{"name": "/add", "type": ADD, "calls": 1, "pending": 1, "taken_by": ""}]


async def test_server_stops(place: Place) -> None:
    """A call that is under way when the server stops is answered before the connection is closed."""
    asked = asyncio.Event()

    async def never(request: Request) -> bytes:
        asked.set()
        await asyncio.Event().wait()
        raise AssertionError

    await serve(place, handler=never)
    client = await place.client()
    for id in ("1", "2"):
        client.send({"op": "call_service", "id": id, "service": "/add", "args": {}, "timeout": 60})
    await asked.wait()
    await until(lambda: len(place.session.services._calls) == 2)
    stopping = asyncio.create_task(place.server.close())
    for id in ("1", "2"):
        answer = await client.json()
        assert (answer["op"], answer["id"], answer["result"]) == ("service_response", id, False)
        assert "the gateway stops" in answer["values"]
    assert (await client.closed())[0] == 1001
    await stopping
