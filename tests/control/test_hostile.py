"""Whoever sends nonsense to the control API gets an answer or is cut off, and nothing else notices."""

from __future__ import annotations

import asyncio
import contextlib
import gc
import hashlib
import random
import socket
from pathlib import Path
from typing import Any

import psutil
import pytest

from ropeway import limits
from ropeway.control.client import find_target
from ropeway.networks.memory.graph import MemoryGraph
from tests.control.conftest import Begin, Controlled
from tests.control.hostile import hostile_request
from tests.support.inbox import Inbox
from tests.support.messages import STRING, sample
from tests.support.until import until

GROWTH_BYTES = 16 << 20
"""What a process may keep of so many requests: caches and arenas that are filled once; a leak of 2 KB each is more."""


class Traffic:
    """Messages that cross two gateways while something else happens."""

    def __init__(self, robot: Controlled, cloud: Controlled) -> None:
        self._here = MemoryGraph(_network(robot), node="/here")
        self._there = MemoryGraph(_network(cloud), node="/there")
        self.inbox = Inbox()
        self.sent = 0

    async def begin(self, stack: contextlib.AsyncExitStack) -> None:
        """Publish here and read there, once the route is up."""
        for graph in (self._here, self._there):
            await graph.open()
            stack.push_async_callback(graph.close)
        await self._there.create_subscription("/count", STRING, None, self.inbox)
        self._publisher = await self._here.create_publisher("/count", STRING)
        await until(lambda: self._publisher.subscribers)

    def send(self) -> None:
        """Send the next number."""
        self._publisher.publish(sample(str(self.sent)))
        self.sent += 1


def _network(made: Controlled) -> str:
    return made.gateway.config.gateway.graphs[0].removeprefix("memory:")


async def _ask(path: Path | None, sent: bytes) -> bytes:
    """Send bytes on a connection of their own, and return what comes first, if anything."""
    reader, writer = await asyncio.open_unix_connection(str(path))
    with contextlib.suppress(ConnectionError):
        writer.write(sent)
        writer.write_eof()
        await writer.drain()
    answer = b""
    with contextlib.suppress(ConnectionError, TimeoutError):
        answer = await asyncio.wait_for(reader.read(12), 2.0)  # a stream of events says nothing more for a while
    writer.close()
    return answer


@pytest.mark.parametrize("count", [600, pytest.param(10_000, marks=pytest.mark.slow)])
async def test_hostile_requests_by_the_thousand(begin: Begin, count: int) -> None:
    """Requests of many kinds fail nothing, change nothing, leave nothing behind, and no message is lost meanwhile."""
    cloud = await begin(listen=["ws://127.0.0.1:0"])
    port = cloud.gateway.servers[0].listeners[0].port
    robot = await begin([{"address": f"ws://127.0.0.1:{port}", "publish": [{"name": "/count", "type": STRING}]}])
    etag, dice = robot.gateway.config.etag, random.Random(7)
    answers: list[bytes] = []
    async with contextlib.AsyncExitStack() as stack:
        traffic = Traffic(robot, cloud)
        await traffic.begin(stack)

        async def attack(requests: int) -> None:
            for _ in range(requests):
                answers.append(await _ask(robot.target.socket, hostile_request(dice)))
                traffic.send()

        async def wave(requests: int) -> None:
            await asyncio.gather(*(attack(requests // 10) for _ in range(10)))
            gc.collect()

        await wave(count // 2)
        before = psutil.Process().memory_info().rss
        await wave(count // 2)
        grown = psutil.Process().memory_info().rss - before
        await until(lambda: len(traffic.inbox.samples) == traffic.sent)
    assert robot.gateway.config.etag == etag
    assert not [answer for answer in answers if answer.startswith(b"HTTP/1.1 5")]
    assert sum(answer.startswith(b"HTTP/1.1 4") for answer in answers) > count / 4
    assert grown < GROWTH_BYTES
    assert (await robot.client.get("/v1/status")).status_code == 200
    assert robot.manager.events.readers == 0


async def test_slow_requests(begin: Begin, monkeypatch: pytest.MonkeyPatch) -> None:
    """Bodies and heads that come byte by byte are cut after a while, and others are answered meanwhile."""
    monkeypatch.setattr("ropeway.control.server.CONTROL_REQUEST_S", 0.3)
    monkeypatch.setattr("ropeway.control.app.CONTROL_REQUEST_S", 0.3)
    made = await begin()
    head = b"PUT /v1/config HTTP/1.1\r\nhost: x\r\ncontent-type: application/json\r\ncontent-length: 9999\r\n\r\n"

    async def drip(start: bytes) -> bytes:
        reader, writer = await asyncio.open_unix_connection(str(made.target.socket))
        writer.write(start)
        dripping = asyncio.create_task(_drip(writer))
        try:
            return await reader.read(12)
        except ConnectionError:
            return b""
        finally:
            dripping.cancel()
            writer.close()

    slow = [asyncio.create_task(drip(head if n % 2 else b"GET /v1/st")) for n in range(40)]
    while not all(task.done() for task in slow):
        assert (await made.client.get("/v1/routes")).status_code == 200
    assert {task.result() for task in slow} == {b"", b"HTTP/1.1 408"}


async def _drip(writer: asyncio.StreamWriter) -> None:
    with contextlib.suppress(ConnectionError):
        while True:
            writer.write(b" ")
            await writer.drain()
            await asyncio.sleep(0.01)


async def test_pipelines_are_answered_in_order(begin: Begin) -> None:
    """Requests that are sent without waiting are answered one after the other, on one connection."""
    made = await begin()
    reader, writer = await asyncio.open_unix_connection(str(made.target.socket))
    paths = ["/v1/routes", "/v1/nothing", "/v1/events", "/v1/sessions"] * 25
    writer.write(b"".join(b"GET %b HTTP/1.1\r\nhost: x\r\n\r\n" % path.encode() for path in paths))
    statuses = []
    for _ in paths:
        head = await reader.readuntil(b"\r\n\r\n")
        statuses.append(int(head.split()[1]))
        length = next(line for line in head.split(b"\r\n") if line.lower().startswith(b"content-length"))
        await reader.readexactly(int(length.split(b":")[1]))
    assert statuses == [200, 404, 200, 200] * 25
    writer.close()


async def test_who_reads_no_answer(begin: Begin) -> None:
    """Who asks again and again and reads nothing has no more than a bounded amount of answers waiting."""
    remote = {"address": "ws://127.0.0.1:9", "publish": [{"name": f"/t{n}", "type": STRING} for n in range(100)]}
    made = await begin([remote])
    size = len((await made.client.get("/v1/status")).content)
    asked = b"GET /v1/status HTTP/1.1\r\nhost: x\r\n\r\n"
    with socket.socket(socket.AF_UNIX) as silent:
        silent.setblocking(False)
        loop = asyncio.get_running_loop()
        await loop.sock_connect(silent, str(made.target.socket))
        with contextlib.suppress(TimeoutError):
            await asyncio.wait_for(loop.sock_sendall(silent, asked * 20_000), 2.0)
        before = psutil.Process().memory_info().rss
        for _ in range(20):
            assert len((await made.client.get("/v1/status")).content) >= size
        assert psutil.Process().memory_info().rss - before < GROWTH_BYTES


async def test_a_wrong_token_a_thousand_times(begin: Begin) -> None:
    """Wrong tokens are counted, answered later and later, and then locked out, while the right one still gets in."""
    token = hashlib.sha256(b"right").hexdigest()
    auth: dict[str, Any] = {
        "tokens": [{"hash": f"sha256:{token}", "role": "watcher"}],
        "roles": {"watcher": {"control": ["observe"]}},
    }
    made = await begin(control={"listen": ["http://127.0.0.1:0"]}, auth=auth)
    target = find_target(made.control.addresses[0])
    async with target.async_client(timeout_s=60.0) as guesser:
        statuses: list[int] = []

        async def guess(start: int) -> None:
            for n in range(start, 1_000, 50):
                answer = await guesser.get("/v1/status", headers={"authorization": f"Bearer guess-{n}"})
                statuses.append(answer.status_code)

        await asyncio.gather(*(guess(start) for start in range(50)))
    assert len(statuses) == 1_000
    assert set(statuses) == {401, 429}
    assert statuses.count(401) < 5 * limits.WRONG_TOKENS  # a busy machine outlasts a lock or two
    assert sum(made.control.status()["refused"].values()) == 1_000
    assert (await made.client.get("/v1/status")).status_code == 200  # on the socket of the user
