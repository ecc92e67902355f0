"""Topics are posted to web servers, and URLs are services, whatever the servers answer."""

from __future__ import annotations

import asyncio
import json
import ssl
from collections.abc import AsyncIterator, Awaitable, Callable
from pathlib import Path
from typing import Any

import pytest

from ropeway.errors import CallFailed, ConfigError
from ropeway.gateway.config.config import parse
from ropeway.graph.base import SEQ_NONE, Sample, new_origin
from ropeway.graph.calls import Request
from ropeway.limits import REST_BODY_BYTES
from ropeway.types import TypeRegistry
from tests.support.authority import Authority
from tests.support.until import until
from tests.support.world import World

STRING = "std_msgs/msg/String"
BOOL = "std_srvs/srv/SetBool"
REGISTRY = TypeRegistry()

Answer = Callable[[bytes], Awaitable[tuple[int, bytes]]]


class Web:
    """A web server that answers as a test says, and keeps what it got."""

    def __init__(self) -> None:
        self.bodies: list[Any] = []
        self.heads: list[bytes] = []
        self.media_type = b"application/json"
        self.answers: list[tuple[int, bytes]] = []
        self.free = asyncio.Event()
        self.free.set()
        self.url = ""

    async def serve(self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        head = await reader.readuntil(b"\r\n\r\n")
        size = next(int(line.split(b":")[1]) for line in head.split(b"\r\n") if line.lower().startswith(b"content-len"))
        self.heads.append(head.lower())
        body = await reader.readexactly(size)
        self.bodies.append(json.loads(body) if b"application/json" in head else body)
        await self.free.wait()
        status, body = self.answers.pop(0) if self.answers else (200, b"{}")
        head = b"HTTP/1.1 %d X\r\ncontent-type: %b\r\ncontent-length: %d\r\nconnection: close\r\n\r\n"
        writer.write(head % (status, self.media_type, len(body)) + body)
        writer.close()


@pytest.fixture
async def web() -> AsyncIterator[Web]:
    web = Web()
    server = await asyncio.start_server(web.serve, "127.0.0.1", 0)
    web.url = f"http://127.0.0.1:{server.sockets[0].getsockname()[1]}/x"
    yield web
    web.free.set()
    server.close()


def _sample(data: str) -> Sample:
    return Sample(REGISTRY.codec(STRING).encode({"data": data}), STRING, 0, new_origin(), SEQ_NONE)


async def test_a_topic_is_posted_and_answered(world: World, web: Web) -> None:
    """A message is posted as JSON, tried again after an error of the server, and the answer is published."""
    web.answers = [(503, b""), (200, b'{"data": "answer"}')]
    rule = {"service_uri": web.url, "topic": "/a", "type": STRING, "answer": {"topic": "/b", "type": STRING}}
    gateway = await world.gateway("a", [], http=[rule])
    robot = await world.robot("a")
    got: list[Sample] = []
    await robot.create_subscription("/b", STRING, None, got.extend)
    publisher = await robot.create_publisher("/a", STRING)
    await until(lambda: publisher.subscribers)
    publisher.publish(_sample("question"))
    await until(lambda: got)
    assert web.bodies == [{"data": "question"}] * 2
    assert REGISTRY.codec(STRING).decode(got[0].payload)["data"] == "answer"
    await until(lambda: gateway.status()["http"][0]["counts"].get("posted"))
    assert gateway.status()["http"][0]["counts"]["tried again"] == 1


async def test_the_newest_is_posted(world: World, web: Web) -> None:
    """While a server takes its time, newer messages take the place of older ones, and that is counted."""
    web.free.clear()
    gateway = await world.gateway("a", [], http=[{"url": web.url, "topic": "/a", "type": STRING}])
    robot = await world.robot("a")
    publisher = await robot.create_publisher("/a", STRING)
    await until(lambda: publisher.subscribers)
    publisher.publish(_sample("0"))
    await until(lambda: web.bodies)
    for number in range(1, 6):
        publisher.publish(_sample(str(number)))
    await until(lambda: gateway.status()["http"][0]["counts"].get("replaced by newer") == 4)
    web.free.set()
    await until(lambda: len(web.bodies) == 2)
    assert web.bodies == [{"data": "0"}, {"data": "5"}]


@pytest.mark.parametrize(
    ("answer", "said"),
    [
        ((500, b""), "answered 500"),
        ((200, b"<html>"), "JSON"),
        ((200, b'{"success": "no"}'), "success"),
        ((200, bytes(REST_BODY_BYTES + 1)), "longer than"),
    ],
)
async def test_a_bad_answer_fails_the_call(world: World, web: Web, answer: tuple[int, bytes], said: str) -> None:
    """A URL is a service; what it answers badly fails the call with the reason, and the next call is answered."""
    await world.gateway("a", [], http=[{"url": web.url, "service": "/s", "type": BOOL}])
    robot = await world.robot("a")
    client = await robot.create_client("/s", BOOL)
    await until(lambda: client.available)
    request = REGISTRY.codec(f"{BOOL}_Request").encode({"data": True})
    web.answers = [answer, (200, b'{"success": true, "message": "on"}')]
    with pytest.raises(CallFailed, match=said):
        await client.call(Request(request))
    response = await client.call(Request(request))
    assert REGISTRY.codec(f"{BOOL}_Response").decode(response)["message"] == "on"
    assert web.bodies == [{"data": True}] * 2


@pytest.mark.parametrize("trusted", [True, False])
async def test_an_authority_of_ones_own(world: World, web: Web, tmp_path: Path, trusted: bool) -> None:
    """Over https the server's certificate has to be of an authority that is trusted: ``ca``, or those of the system."""
    authority = Authority(tmp_path, "own")
    context = ssl.SSLContext(ssl.PROTOCOL_TLS_SERVER)
    signed = authority.sign("server")
    context.load_cert_chain(signed["certificate"], signed["key"])
    server = await asyncio.start_server(web.serve, "127.0.0.1", 0, ssl=context)
    url = f"https://127.0.0.1:{server.sockets[0].getsockname()[1]}/"
    rule = {"url": url, "service": "/s", "type": BOOL, "headers": {"x-team": "ours"}}
    await world.gateway("a", [], http=[{**rule, **({"ca": authority.file} if trusted else {})}])
    robot = await world.robot("a")
    client = await robot.create_client("/s", BOOL)
    await until(lambda: client.available)
    request = Request(REGISTRY.codec(f"{BOOL}_Request").encode({"data": True}))
    web.answers = [(200, b'{"success": true}')]
    if trusted:
        await client.call(request)
        assert b"x-team: ours" in web.heads[0]
    else:
        with pytest.raises(CallFailed, match="certificate"):
            await client.call(request)
        assert not web.bodies
    server.close()


async def test_a_form_is_posted(world: World, web: Web) -> None:
    """A picture goes as a file, and a picture that is answered is published."""
    image = "sensor_msgs/msg/CompressedImage"
    answer = {"topic": "/b", "type": image}
    await world.gateway("a", [], http=[{"url": web.url, "topic": "/a", "type": image, "files": [{}], "answer": answer}])
    robot = await world.robot("a")
    got: list[Sample] = []
    await robot.create_subscription("/b", image, None, got.extend)
    publisher = await robot.create_publisher("/a", image)
    await until(lambda: publisher.subscribers)
    web.answers, web.media_type = [(200, b"seen")], b"image/png"
    payload = REGISTRY.codec(image).encode({"format": "jpeg", "data": b"picture"})
    publisher.publish(Sample(payload, image, 0, new_origin(), SEQ_NONE))
    await until(lambda: got)
    assert b'name="file"; filename="file.jpg"\r\nContent-Type: image/jpeg\r\n\r\npicture' in web.bodies[0]
    assert bytes(REGISTRY.codec(image).decode(got[0].payload)["data"]) == b"seen"


async def test_a_server_that_never_answers(world: World, web: Web) -> None:
    """A call to a server that says nothing fails in time."""
    web.free.clear()
    await world.gateway("a", [], http=[{"url": web.url, "service": "/s", "type": BOOL, "timeout_s": 0.1}])
    robot = await world.robot("a")
    client = await robot.create_client("/s", BOOL)
    await until(lambda: client.available)
    with pytest.raises(CallFailed, match=r"no answer within 0\.1 s"):
        await client.call(Request(REGISTRY.codec(f"{BOOL}_Request").encode({})))


@pytest.mark.parametrize(
    "rule",
    [
        {"url": "ftp://a/", "topic": "/a", "type": STRING},
        {"url": "http://a/"},
        {"url": "http://a/", "type": STRING},
        {"url": "http://a/", "topic": "/a", "service": "/b", "type": STRING},
        {"url": "http://me:secret@a/", "topic": "/a", "type": STRING},
        {"url": "http://a/", "topic": "/a", "type": STRING, "token": {"env": "X"}},
    ],
)
def test_a_wrong_rule_is_refused(rule: dict[str, Any]) -> None:
    """A rule that cannot be meant is refused where it stands."""
    with pytest.raises(ConfigError, match=r"gateway\.http\[0\]"):
        parse({"gateway": {"graphs": ["memory:a"], "http": [rule]}})
