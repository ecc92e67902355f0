"""rosapi as clients of the server meet it."""

from __future__ import annotations

import json

import pytest

from ropeway.graph.calls import Request
from tests.support.actions import FIBONACCI
from tests.support.messages import STRING
from tests.support.place import Place

pytestmark = pytest.mark.jumping


@pytest.mark.parametrize("service", ["/rosapi/topic_type", "rosapi/topic_type", "/rosapi/topic_type#7"])
async def test_both_names(place: Place, service: str) -> None:
    """A call is answered under the name that it came with, with the fields in order."""
    await place.robot.create_publisher("/chatter", STRING)
    client = await place.client()
    client.send({"op": "call_service", "service": service, "args": {"topic": "/chatter"}, "id": "7"})
    got = await client.receive()
    assert json.loads(got.data) == {
        "op": "service_response",
        "service": service,
        "values": {"type": STRING},
        "result": True,
        "id": "7",
    }


async def test_a_hundred_nodes_at_once(place: Place) -> None:
    """The details of a hundred nodes, asked for in one go, are answered each under its id."""
    for number in range(100):
        node = await place.participant(f"/node{number}")
        await node.create_publisher(f"/out{number}", STRING)
    client = await place.client()
    for number in range(100):
        args = {"node": f"/node{number}"}
        client.send({"op": "call_service", "service": "/rosapi/node_details", "args": args, "id": f"call:{number}"})
    answers = [await client.json() for _ in range(100)]
    found = {answer["id"]: answer["values"]["publishing"] for answer in answers}
    assert found == {f"call:{number}": [f"/out{number}"] for number in range(100)}


async def test_bad_arguments(place: Place) -> None:
    """Arguments of the wrong type and services that are none are answered with the reason."""
    client = await place.client()
    client.send({"op": "call_service", "service": "/rosapi/topic_type", "args": {"topic": 5}, "id": "1"})
    answer = await client.json()
    assert answer["result"] is False
    assert "requires a string for field topic" in answer["values"]
    client.send({"op": "call_service", "service": "/rosapi/what", "id": "2"})
    assert (await client.json())["values"] == "Service /rosapi/what does not exist"


async def test_a_newer_service_on_the_network(place: Place) -> None:
    """What rosapi of the server does not know is looked for on the graph."""

    async def handler(request: Request) -> bytes:
        return place.registry.codec("std_srvs/srv/Trigger_Response").encode({"success": True, "message": "new"})

    await place.robot.create_service("/rosapi/brand_new", "std_srvs/srv/Trigger", handler)
    client = await place.client()
    client.send({"op": "call_service", "service": "/rosapi/brand_new", "id": "1"})
    assert (await client.json())["values"] == {"success": True, "message": "new"}


async def test_what_clients_offer_is_listed(place: Place) -> None:
    """Topics, services and actions of one client are told to another, as those of the gateway's node."""
    robot, browser = await place.client(), await place.client()
    robot.send({"op": "advertise", "topic": "/chatter", "type": "std_msgs/String"})
    robot.send({"op": "advertise_service", "service": "/lamp", "type": "std_srvs/SetBool"})
    robot.send({"op": "advertise_action", "action": "/fibonacci", "type": "example_interfaces/Fibonacci"})
    await robot.done()

    async def ask(service: str, /, **args: str) -> object:
        browser.send({"op": "call_service", "service": f"/rosapi/{service}", "args": args, "id": service})
        answer = await browser.json()
        assert answer["id"] == service
        return answer["values"]

    assert await ask("topic_type", topic="/chatter") == {"type": STRING}
    assert await ask("publishers", topic="/chatter") == {"publishers": ["/gateway"]}
    assert await ask("service_type", service="/lamp") == {"type": "std_srvs/srv/SetBool"}
    assert await ask("action_servers") == {"action_servers": ["/fibonacci"]}
    assert await ask("action_type", action="/fibonacci") == {"type": FIBONACCI}
    assert await ask("nodes") == {"nodes": ["/gateway", "/robot"]}
