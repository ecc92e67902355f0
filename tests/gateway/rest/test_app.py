"""Topics and services are REST resources at a rosbridge listener, with its roles."""

from __future__ import annotations

import asyncio
import base64
import json
from collections.abc import AsyncIterator, Awaitable, Callable
from contextlib import AsyncExitStack
from typing import Any

import httpx
import pytest

from ropeway.gateway.gateway import Gateway
from ropeway.graph.base import SEQ_NONE, Sample, new_origin
from ropeway.limits import REST_BODY_BYTES
from ropeway.networks.memory.graph import MemoryGraph
from ropeway.types import TypeRegistry
from tests.support.until import until
from tests.support.world import World

STRING = "std_msgs/msg/String"
IMAGE = "sensor_msgs/msg/CompressedImage"
BOOL = "std_srvs/srv/SetBool"
REGISTRY = TypeRegistry()

Begin = Callable[..., Awaitable[tuple[Gateway, MemoryGraph, httpx.AsyncClient]]]


@pytest.fixture
async def begin(world: World) -> AsyncIterator[Begin]:
    """Begin gateways with REST, each with a participant of its network and a client."""
    async with AsyncExitStack() as stack:

        async def begin(**settings: Any) -> tuple[Gateway, MemoryGraph, httpx.AsyncClient]:
            gateway = await world.gateway("a", [], rest=True, **settings)
            port = gateway.servers[0].listeners[0].port
            client = await stack.enter_async_context(httpx.AsyncClient(base_url=f"http://127.0.0.1:{port}", timeout=60))
            return gateway, await world.robot("a"), client

        yield begin


def _sample(data: str) -> Sample:
    return Sample(REGISTRY.codec(STRING).encode({"data": data}), STRING, 0, new_origin(), SEQ_NONE)


async def test_a_message_is_published(begin: Begin) -> None:
    """A message of JSON reaches the network, bytes in base64; the type is that of the topic, or of the request."""
    _, robot, client = await begin()
    got: list[Sample] = []
    await robot.create_subscription("/image", IMAGE, None, got.extend)
    answer = await client.post("/ros/topics/image", json={"format": "jpeg", "data": base64.b64encode(b"abc").decode()})
    assert (answer.status_code, answer.json()) == (200, {"topic": "/image", "type": IMAGE, "readers": 1})
    await until(lambda: got)
    assert REGISTRY.codec(IMAGE).decode(got[0].payload)["data"] == b"abc"
    answer = await client.post("/ros/topics/new/name", params={"type": "std_msgs/String"}, json={"data": "x"})
    assert (answer.status_code, answer.json()["topic"]) == (200, "/new/name")


async def test_the_last_message_is_read(begin: Begin) -> None:
    """The first request waits for a message, later ones get the last at once, with its age."""
    _, robot, client = await begin()
    publisher = await robot.create_publisher("/chatter", STRING)
    asked = asyncio.create_task(client.get("/ros/topics/chatter"))
    await until(lambda: publisher.subscribers)
    publisher.publish(_sample("one"))
    answer = await asked
    assert (answer.json(), answer.headers["x-type"]) == ({"data": "one"}, STRING)
    publisher.publish(_sample("two"))
    answer = await client.get("/ros/topics/chatter")
    assert answer.json() == {"data": "two"}
    listed = (await client.get("/ros/topics")).json()
    assert {"name": "/chatter", "types": [STRING]} in listed


async def test_a_topic_is_streamed(begin: Begin) -> None:
    """A topic is a stream of server-sent events; a reader that is slower is told how many it has missed."""
    _, robot, client = await begin()
    publisher = await robot.create_publisher("/chatter", STRING)
    async with client.stream("GET", "/ros/topics/chatter", headers={"accept": "text/event-stream"}) as answer:
        lines = answer.aiter_lines()
        await until(lambda: publisher.subscribers)
        for number in range(100):
            publisher.publish(_sample(str(number)))
        seen: list[str] = []
        missed = 0
        while not seen or seen[-1] != "99":
            line = await anext(lines)
            if line.startswith("data: "):
                seen.append(json.loads(line.removeprefix("data: "))["data"])
            elif line.endswith("skipped"):
                missed += int(line.split()[1])
    assert len(seen) + missed == 100


async def test_a_service_is_called(begin: Begin) -> None:
    """A call is answered with the response; one that nobody serves, or that fails, with a fitting status."""
    _, robot, client = await begin()
    codec = REGISTRY.codec(f"{BOOL}_Response")
    answers = [codec.encode({"success": True, "message": "on"})]

    async def serve(_: Any) -> bytes:
        return answers[0]

    assert (await client.post("/ros/services/motor", json={})).status_code == 404
    await robot.create_service("/motor", BOOL, serve)
    answer = await client.post("/ros/services/motor", json={"data": True})
    assert (answer.status_code, answer.json()) == (200, {"success": True, "message": "on"})

    async def hang(_: Any) -> bytes:
        await asyncio.Event().wait()
        return b""

    await robot.create_service("/stuck", BOOL, hang)
    answer = await client.post("/ros/services/stuck", params={"timeout": 0.05}, json={})
    assert answer.status_code == 504


@pytest.mark.parametrize(
    ("method", "path", "more", "status", "word"),
    [
        ("POST", "/ros/topics/a?type=std_msgs/msg/String", {"json": {"data": 5}}, 422, "data"),
        ("POST", "/ros/topics/a?type=std_msgs/msg/String", {"json": {"dta": "x"}}, 422, "dta"),
        ("POST", "/ros/topics/a?type=std_msgs/msg/String", {"json": [1]}, 422, ""),
        ("POST", "/ros/topics/a?type=std_msgs/msg/String", {"content": b"{", "headers": {}}, 400, ""),
        ("POST", "/ros/topics/a?type=no_such/msg/Thing", {"json": {}}, 422, "no_such/msg/Thing"),
        ("POST", "/ros/topics/a", {"json": {}}, 404, "?type="),
        ("POST", "/ros/topics/a%20b?type=std_msgs/msg/String", {"json": {}}, 422, ""),
        ("POST", "/ros/topics/a?type=std_msgs/msg/String", {"data": {"data": "x"}}, 415, "application/json"),
        ("GET", "/ros/topics/a?type=std_msgs/msg/String&timeout=0.01", {}, 504, "0.01 s"),
        ("GET", "/ros/topics/a?type=std_msgs/msg/String&timeout=soon", {}, 422, "timeout"),
        ("DELETE", "/ros/topics/a", {}, 405, "DELETE"),
        ("GET", "/ros/services/a", {}, 405, "GET"),
        ("GET", "/ros/things", {}, 404, "/ros/topics"),
    ],
)
async def test_a_wrong_request_is_explained(
    begin: Begin, method: str, path: str, more: dict[str, Any], status: int, word: str
) -> None:
    """A request that cannot be carried out is answered with a status of its own and a sentence."""
    _, _, client = await begin()
    if "headers" in more:
        more = {**more, "headers": {"content-type": "application/json"}}
    answer = await client.request(method, path, **more)
    assert answer.status_code == status, answer.text
    assert word in answer.json()["error"]


async def test_a_body_is_bounded(begin: Begin) -> None:
    """A body that is too long is refused unread, whether it says so or not."""
    _, _, client = await begin()
    headers = {"content-type": "application/json"}

    async def endless() -> AsyncIterator[bytes]:
        for _ in range(REST_BODY_BYTES // 65_536 + 2):
            yield bytes(65_536)

    answer = await client.post("/ros/topics/a?type=std_msgs/msg/String", content=endless(), headers=headers)
    assert answer.status_code == 413


async def test_roles_count(begin: Begin, monkeypatch: pytest.MonkeyPatch) -> None:
    """Tokens are asked for, and a role publishes, reads and calls what it lists and nothing else."""
    monkeypatch.setenv("REST_TOKEN", "right-and-long")
    role = {"publish": ["/cmd"], "subscribe": ["/odom"]}
    auth = {"tokens": [{"token": {"env": "REST_TOKEN"}, "role": "driver"}], "roles": {"driver": role}}
    _, robot, client = await begin(auth=auth)
    await robot.create_publisher("/secret", STRING)
    assert (await client.get("/ros/topics")).status_code == 401
    client.headers["authorization"] = "Bearer right-and-long"
    assert (await client.get("/ros/topics")).json() == []
    kind = {"type": STRING}
    assert (await client.post("/ros/topics/cmd", params=kind, json={"data": "x"})).status_code == 200
    assert (await client.post("/ros/topics/odom", params=kind, json={"data": "x"})).status_code == 403
    assert (await client.get("/ros/topics/secret")).status_code == 403
    assert (await client.post("/ros/services/motor", json={})).status_code == 403
    page = {"origin": "https://strange.example"}
    assert (await client.post("/ros/topics/cmd", params=kind, json={"data": "x"}, headers=page)).status_code == 403


async def test_a_page_asks_before(begin: Begin, monkeypatch: pytest.MonkeyPatch) -> None:
    """A browser that asks for a page of an origin that is let in needs no token for that, and others are refused."""
    monkeypatch.setenv("REST_TOKEN", "right-and-long")
    tokens = [{"token": {"env": "REST_TOKEN"}, "role": "all"}]
    _, _, client = await begin(auth={"tokens": tokens, "origins": ["https://dash.example"]})
    asked = {"access-control-request-method": "POST", "access-control-request-headers": "authorization"}
    answer = await client.options("/ros/topics/cmd", headers={**asked, "origin": "https://dash.example"})
    assert answer.status_code == 204
    assert answer.headers["access-control-allow-origin"] == "https://dash.example"
    assert "POST" in answer.headers["access-control-allow-methods"]
    assert "authorization" in answer.headers["access-control-allow-headers"]
    strange = await client.options("/ros/topics/cmd", headers={**asked, "origin": "https://strange.example"})
    assert strange.status_code == 403
    assert (await client.options("/ros/topics/cmd")).status_code == 401


async def test_without_rest_there_is_nothing(world: World) -> None:
    """A gateway that was not asked to has no such resources."""
    gateway = await world.gateway("a", [])
    port = gateway.servers[0].listeners[0].port
    async with httpx.AsyncClient(base_url=f"http://127.0.0.1:{port}") as client:
        assert (await client.get("/ros/topics")).status_code == 404
