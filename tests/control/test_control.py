"""ropeway.control.control: the control API of a gateway, over its sockets."""

from __future__ import annotations

import asyncio
import contextlib
import hashlib
import json
import socket
from pathlib import Path
from typing import Any

import httpx
import pytest

from ropeway import aio, limits
from ropeway.control import app as app_module
from ropeway.control import place
from ropeway.control import server as server_module
from ropeway.control.client import find_target, fleet
from ropeway.errors import ControlUnavailable, NameTaken
from ropeway.gateway.config.check import check
from tests.control.conftest import Begin, Controlled
from tests.support.messages import STRING
from tests.support.until import PATIENCE_S

JSON = {"content-type": "application/json"}
TOKEN = "a-secret-token"
AUTH = {
    "tokens": [
        {"hash": f"sha256:{hashlib.sha256(TOKEN.encode()).hexdigest()}", "role": "watcher"},
        {"hash": f"sha256:{hashlib.sha256(b'none').hexdigest()}", "role": "robot"},
    ],
    "roles": {"watcher": {"control": ["observe"]}, "robot": {"publish": ["*"]}},
}


async def test_status_over_the_socket(begin: Begin) -> None:
    """The gateway is found by its name, and tells its state, with a row for each route."""
    remote = {"address": "ws://127.0.0.1:9", "publish": [{"name": "/a", "type": STRING}]}
    made = await begin([remote])
    answer = await made.client.get("/v1/status")
    assert answer.status_code == 200
    status = answer.json()
    assert status["name"] == made.gateway.config.gateway.name
    (route,) = status["routes"]
    assert (route["name"], route["kind"], route["operation"]) == ("/a", "topic", "publish")
    assert route["key"] == made.gateway.config.routes()[0].key


@pytest.mark.parametrize(
    ("method", "path", "headers", "status"),
    [
        ("GET", "/v1/nothing", {}, 404),
        ("GET", "/", {}, 404),
        ("PATCH", "/v1/status", JSON, 405),
        ("POST", "/v1/status", {}, 415),
        ("POST", "/v1/status", {"content-type": "text/plain"}, 415),
        ("POST", "/v1/status", {"content-type": "application/x-www-form-urlencoded"}, 415),
        ("GET", "/v1/status", {"origin": "http://evil.example"}, 403),
        ("GET", "/v1/events?after=x", {}, 422),
    ],
)
async def test_what_is_refused(begin: Begin, method: str, path: str, headers: dict[str, str], status: int) -> None:
    """What is not there, or what a web page could send, is refused with an error that says so, in JSON."""
    made = await begin()
    answer = await made.client.request(method, path, headers=headers)
    assert answer.status_code == status
    assert answer.json()["error"]


async def test_the_document(begin: Begin) -> None:
    """The OpenAPI document describes every resource; what it refers to is there."""
    made = await begin()
    document = (await made.client.get("/openapi.json")).json()
    assert document["openapi"] == "3.1.0"
    assert {"/v1/status", "/v1/events", "/v1/events/stream"} <= set(document["paths"])
    for _, operations in document["paths"].items():
        for operation in operations.values():
            assert operation["summary"]

    def references(value: Any) -> list[str]:
        if isinstance(value, dict):
            own = [value["$ref"]] if isinstance(value.get("$ref"), str) else []
            return own + [found for item in value.values() for found in references(item)]
        return [found for item in value for found in references(item)] if isinstance(value, list) else []

    for reference in references(document):
        assert reference.removeprefix("#/components/schemas/") in document["components"]["schemas"]


async def test_long_bodies_are_refused(begin: Begin, monkeypatch: pytest.MonkeyPatch) -> None:
    """A body above the limit is refused, whether its length is announced or not."""
    monkeypatch.setattr(app_module, "CONTROL_BODY_BYTES", 1000)
    made = await begin()

    async def chunks() -> Any:
        for _ in range(10):
            yield b"x" * 1000

    for content in (b"x" * 5000, chunks()):
        answer = await made.client.request("GET", "/v1/status", content=content)
        assert answer.status_code == 413
    assert (await made.client.get("/v1/status")).status_code == 200


async def test_a_request_that_never_ends_is_cut(begin: Begin, monkeypatch: pytest.MonkeyPatch) -> None:
    """A connection that sends no whole head in time is closed, the second request of one likewise."""
    monkeypatch.setattr(server_module, "CONTROL_REQUEST_S", 0.05)
    made = await begin()
    for before in (b"", b"GET /v1/events HTTP/1.1\r\nhost: x\r\n\r\n"):
        reader, writer = await asyncio.open_unix_connection(str(made.target.socket))
        if before:
            writer.write(before)
            assert (await reader.readuntil(b"[]")).startswith(b"HTTP/1.1 200")
        writer.write(b"GET /v1/st")
        with contextlib.suppress(ConnectionResetError):
            async with aio.timeout(PATIENCE_S):
                assert not await reader.read()
        writer.close()


async def test_too_many_connections(begin: Begin, monkeypatch: pytest.MonkeyPatch) -> None:
    """Connections above the limit are closed; those below go on."""
    monkeypatch.setattr(server_module.ControlServer.__init__, "__kwdefaults__", {"max_connections": 3})
    made = await begin()
    assert (await made.client.get("/v1/status")).status_code == 200
    opened = [await asyncio.open_unix_connection(str(made.target.socket)) for _ in range(5)]
    closed = 0
    for reader, _ in opened[2:]:
        try:
            closed += not await reader.read(1)
        except ConnectionResetError:
            closed += 1
    assert closed == 3
    assert (await made.client.get("/v1/status")).status_code == 200
    for _, writer in opened:
        writer.close()


async def test_hostile_requests(begin: Begin) -> None:
    """Bytes that are no HTTP are answered or cut, and the API goes on."""
    made = await begin()
    hostile = [
        b"\0" * 100,
        b"GET / HTTP/9.9\r\n\r\n",
        b"GET " + b"/x" * 20_000 + b" HTTP/1.1\r\nhost: x\r\n\r\n",
        b"POST /v1/status HTTP/1.1\r\nhost: x\r\ncontent-length: -1\r\n\r\n",
        b"POST /v1/status HTTP/1.1\r\nhost: x\r\ncontent-length: 99999999999\r\ncontent-type: application/json\r\n\r\n",
        b"GET /v1/status HTTP/1.1\r\nhost: x\r\norigin: http://a\r\norigin: http://b\r\n\r\n",
        b"GET /v1/status HTTP/1.1\r\nhost: x\r\nupgrade: websocket\r\nconnection: upgrade\r\n\r\n",
        b"GET /%ff%00/../../etc/passwd HTTP/1.1\r\nhost: x\r\n\r\n",
    ]
    for sent in hostile:
        reader, writer = await asyncio.open_unix_connection(str(made.target.socket))
        writer.write(sent)
        answer = await reader.read(1000)
        assert answer.startswith(b"HTTP/1.1 ")
        writer.close()
    assert (await made.client.get("/v1/status")).status_code == 200


async def test_events_are_streamed(begin: Begin) -> None:
    """A reader of the stream gets events with their numbers, and another what it missed by the last number it had."""
    made = await begin()

    async def first(headers: dict[str, str], count: int) -> list[dict[str, Any]]:
        found = []
        async with made.client.stream("GET", "/v1/events/stream", headers=headers, timeout=None) as answer:
            assert answer.headers["content-type"].startswith("text/event-stream")
            if not headers:
                made.manager.events.tell("route", "/a", state="active")
                made.manager.events.tell("route", "/b", state="failed")
            async for line in answer.aiter_lines():
                if line.startswith("data: "):
                    found.append(json.loads(line[6:]))
                if len(found) == count:
                    break
        return found

    assert [event["name"] for event in await first({}, 2)] == ["/a", "/b"]
    assert [event["name"] for event in await first({"last-event-id": "1"}, 1)] == ["/b"]
    assert [event["name"] for event in (await made.client.get("/v1/events")).json()] == ["/a", "/b"]
    while made.manager.events.readers:
        await asyncio.sleep(0)


async def test_a_reader_that_takes_nothing_is_dropped(begin: Begin, monkeypatch: pytest.MonkeyPatch) -> None:
    """A connection whose reader has stalled is closed after a while, and holds no more than a bounded queue."""
    monkeypatch.setattr(app_module, "CONTROL_READER_S", 0.05)
    made = await begin()
    with socket.socket(socket.AF_UNIX) as stalled:
        stalled.setblocking(False)
        await asyncio.get_running_loop().sock_connect(stalled, str(made.target.socket))
        await asyncio.get_running_loop().sock_sendall(stalled, b"GET /v1/events/stream HTTP/1.1\r\nhost: x\r\n\r\n")
        while not made.manager.events.readers:
            await asyncio.sleep(0.001)
        while made.manager.events.readers:
            made.manager.events.tell("x", "big", text="y" * (limits.CONTROL_EVENT_BYTES // 2))
            await asyncio.sleep(0.001)
    assert (await made.client.get("/v1/status")).status_code == 200


async def test_two_gateways_of_one_name(begin: Begin) -> None:
    """A second gateway of a name is found under the name with a number; one that asks for the name is refused."""
    first = await begin(name="twin")
    second = await begin(name="twin")
    assert [first.control.name, second.control.name] == ["twin", "twin-2"]
    assert {"twin", "twin-2"} <= {target.name for target in fleet()}
    with pytest.raises(NameTaken):
        await begin(control={"name": "twin"})


async def test_switched_off(begin: Begin, monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    """With "control": false there is no socket, and a client says that nobody of the name runs."""
    monkeypatch.setattr(place, "_private_directory", lambda: tmp_path)  # where gateways of this user may run
    with pytest.raises(ControlUnavailable, match=r"no gateway runs here"):
        await begin(name="silent", control=False)


# ── over TCP ───────────────────────────────────────────────────────────────────────────────────────────────────────


async def over_tcp(begin: Begin, token: str | None = TOKEN, **more: Any) -> tuple[Controlled, httpx.AsyncClient]:
    made = await begin(control={"listen": ["http://127.0.0.1:0"]}, auth={**AUTH, **more})
    return made, find_target(made.control.addresses[0], token=token or "").async_client()


async def test_tokens_over_tcp(begin: Begin) -> None:
    """Over TCP a role has the rights that the configuration lists for it, and nobody any without a token."""
    made, client = await over_tcp(begin, default_role="all")
    async with client:
        assert (await client.get("/v1/status")).status_code == 200
        refused = await client.get("/v1/status", headers={"authorization": "Bearer none"})
        assert refused.status_code == 403
        assert 'lacks the right "observe"' in refused.json()["error"]
    async with find_target(made.control.addresses[0]).async_client() as nobody:
        assert (await nobody.get("/v1/status")).status_code == 401


async def test_guessing_tokens(begin: Begin) -> None:
    """Who tries wrong tokens is locked out, and counted."""
    made, client = await over_tcp(begin)
    statuses = set()
    async with client:
        answers = [client.get("/v1/status", headers={"authorization": f"Bearer {n}"}) for n in range(30)]
        statuses = {answer.status_code for answer in await asyncio.gather(*answers)}
    assert statuses == {401, 429}
    assert made.control.status()["tokens"]["wrong tokens"] <= limits.WRONG_TOKENS


@pytest.mark.parametrize("headers", [{"origin": "http://evil.example"}, {"host": "evil.example"}, {"origin": "null"}])
async def test_pages_of_strangers(begin: Begin, headers: dict[str, str]) -> None:
    """Web pages of strangers, and names that a stranger made lead here, get nothing."""
    made, _ = await over_tcp(begin)
    async with find_target(made.control.addresses[0]).async_client() as client:
        answer = await client.get("/v1/status", headers=headers)
        assert answer.status_code == 403


def test_open_over_tcp_is_a_fault() -> None:
    """A control API over TCP without authentication is refused when the configuration is read."""
    _, problems = check({"gateway": {"control": {"listen": ["http://0.0.0.0:9191"]}}}, Path())
    assert [path for path, _ in problems] == ["gateway.control.listen"]


@pytest.mark.parametrize("url", ["ws://127.0.0.1:1", "http://127.0.0.1", "http://x:1/path", "http://[::1:1", "x"])
def test_addresses(url: str) -> None:
    """What is no address of a control API is a fault with what was expected."""
    _, problems = check({"gateway": {"control": {"listen": [url]}}}, Path())
    assert any(path == "gateway.control.listen[0]" and "expected http" in text for path, text in problems)
