"""The ``rosbridge`` graph as a client of a genuine rosbridge server; skipped where rosbridge_suite is not there."""

from __future__ import annotations

import asyncio
import os
import signal
import time
from asyncio.subprocess import DEVNULL, Process
from collections.abc import AsyncIterator
from contextlib import AsyncExitStack
from pathlib import Path
from typing import Any

import pytest

from ropeway import aio
from ropeway.graph.base import SEQ_NONE, Delivery, Sample
from ropeway.networks.dds import DdsGraph
from ropeway.networks.rosbridge.client import LinkState, RosbridgeGraph
from ropeway.qos import LATCHED, QoS
from ropeway.types import TypeRegistry
from tests.support.inbox import Inbox
from tests.support.ports import free_port
from tests.support.ros2 import need_suite
from tests.support.until import PATIENCE_S, until

pytestmark = [pytest.mark.ros, pytest.mark.timeout(120)]
need_suite()

STRING, IMAGE, JOINTS = "std_msgs/msg/String", "sensor_msgs/msg/Image", "sensor_msgs/msg/JointState"
MESSAGES: dict[str, dict[str, Any]] = {
    STRING: {"data": "grüße"},
    IMAGE: {
        "header": {"frame_id": "cam"},
        "height": 2,
        "width": 3,
        "encoding": "mono8",
        "step": 3,
        "data": b"\0\1\2\3\xff\xfe",
    },
    JOINTS: {
        "header": {"frame_id": "arm"},
        "name": ["a", "b"],
        "position": [0.1, -2.5e300],
        "velocity": [],
        "effort": [1.0],
    },
}
DOMAIN = 130 + os.getpid() % 10


class Suite:
    """A genuine server in a domain of its own, and our graph in the same domain beside it."""

    def __init__(self, stack: AsyncExitStack) -> None:
        self.stack = stack
        self.port = free_port()
        self.registry = TypeRegistry()
        self.process: Process | None = None

    async def start(self) -> None:
        prefixes = os.environ["AMENT_PREFIX_PATH"].split(os.pathsep)
        program = next(
            p for p in (Path(x) / "lib/rosbridge_server/rosbridge_websocket" for x in prefixes) if p.exists()
        )
        self.process = await asyncio.create_subprocess_exec(
            str(program),
            *("--ros-args", "-p", "address:=127.0.0.1", "-p", f"port:={self.port}"),
            env={**os.environ, "ROS_DOMAIN_ID": str(DOMAIN)},
            stdout=DEVNULL,
            stderr=DEVNULL,
        )
        deadline = time.monotonic() + 30
        while time.monotonic() < deadline and self.process.returncode is None:
            try:
                _, writer = await asyncio.open_connection("127.0.0.1", self.port)
            except OSError:
                await asyncio.sleep(0.1)
            else:
                writer.close()
                return
        raise TimeoutError("the rosbridge server does not start")

    async def stop(self) -> None:
        if self.process is not None and self.process.returncode is None:
            self.process.send_signal(signal.SIGKILL)
            await self.process.wait()

    async def client(self) -> RosbridgeGraph:
        graph = RosbridgeGraph(f"ws://127.0.0.1:{self.port}", registry=self.registry)
        await graph.open()
        self.stack.push_async_callback(graph.close)
        return graph

    async def network(self) -> DdsGraph:
        graph = DdsGraph(DOMAIN, name="ours", interface="lo", registry=self.registry)
        await graph.open()
        self.stack.push_async_callback(graph.close)
        return graph

    def sample(self, type: str) -> Sample:
        return Sample(self.registry.codec(type).encode(MESSAGES[type]), type, time.time_ns(), bytes(16), SEQ_NONE)

    def told(self, inbox: Inbox, type: str) -> list[bytes]:
        """What arrived, as JSON: senders pad CDR at its end."""
        return [self.registry.codec(type).json(payload) for payload in inbox.payloads]

    def sent(self, type: str) -> bytes:
        """What ``sample`` says, as JSON."""
        return self.registry.codec(type).json(self.sample(type).payload)


@pytest.fixture
async def suite(monkeypatch: pytest.MonkeyPatch) -> AsyncIterator[Suite]:
    """A running server; everything is ended."""
    monkeypatch.setenv("ROS_AUTOMATIC_DISCOVERY_RANGE", "LOCALHOST")
    monkeypatch.delenv("CYCLONEDDS_URI", raising=False)  # genuine nodes have no tag
    async with AsyncExitStack() as stack:
        suite = Suite(stack)
        stack.push_async_callback(suite.stop)
        await suite.start()
        yield suite


async def test_publish(suite: Suite) -> None:
    """What is published arrives whatever encoding is configured, as JSON, and the server never hangs up."""
    client, network = await suite.client(), await suite.network()
    for number, encoding in enumerate(("auto", "none", "cbor", "cbor-raw", "zip", "rawzip", "png", "zstd")):
        for type in MESSAGES:
            topic = f"/p{number}/{type.rsplit('/', 1)[1]}"
            inbox = Inbox()
            await network.create_subscription(topic, type, QoS(depth=10), inbox)
            publisher = await client.create_publisher(topic, type, delivery=Delivery(encoding=encoding))
            async with aio.timeout(PATIENCE_S):
                while not inbox.samples:  # the server needs a moment to match the reader
                    publisher.publish(suite.sample(type))
                    await asyncio.sleep(0.05)
            assert suite.told(inbox, type)[0] == suite.sent(type), encoding
            await publisher.close()
    assert client.connections == 1


@pytest.mark.parametrize("encoding", ["auto", "none", "cbor", "cbor-raw", "zip"])
async def test_subscribe(suite: Suite, encoding: str) -> None:
    """What the server's network publishes arrives in every encoding that it knows, and as JSON in the others."""
    network, client = await suite.network(), await suite.client()
    for type in MESSAGES:
        topic = f"/s/{type.rsplit('/', 1)[1]}"
        publisher = await network.create_publisher(topic, type, QoS(depth=10))
        inbox = Inbox()
        await client.create_subscription(topic, type, None, inbox, delivery=Delivery(encoding=encoding))
        await until(lambda publisher=publisher: publisher.subscribers)
        async with aio.timeout(PATIENCE_S):
            while not inbox.samples:
                publisher.publish(suite.sample(type))
                await asyncio.sleep(0.05)
        assert suite.told(inbox, type)[0] == suite.sent(type)
    assert client.connections == 1


async def test_latched(suite: Suite) -> None:
    """A topic published as latched is latched in the server's network, also by a server that knows no qos."""
    client, network = await suite.client(), await suite.network()
    publisher = await client.create_publisher("/map", STRING, LATCHED)
    publisher.publish(suite.sample(STRING))
    await asyncio.sleep(2.0)  # the server's default forgets after 1 s
    inbox = Inbox()
    await network.create_subscription("/map", STRING, LATCHED, inbox)
    await inbox.wait(1, 20)
    assert suite.told(inbox, STRING) == [suite.sent(STRING)]


async def test_restart(suite: Suite) -> None:
    """A server that comes back gets every advertise and subscribe again, and data flows both ways."""
    client, network = await suite.client(), await suite.network()
    out, back = Inbox(), Inbox()
    await network.create_subscription("/out", STRING, QoS(), out)
    await client.create_subscription("/back", STRING, None, back)
    far = await network.create_publisher("/back", STRING)
    near = await client.create_publisher("/out", STRING)

    async def flows() -> None:
        out.samples.clear()
        back.samples.clear()
        async with aio.timeout(PATIENCE_S):
            while not (out.samples and back.samples):
                near.publish(suite.sample(STRING))
                far.publish(suite.sample(STRING))
                await asyncio.sleep(0.05)

    await flows()
    await suite.stop()
    await until(lambda: client.state is not LinkState.CONNECTED)
    await suite.start()
    await until(lambda: client.state is LinkState.CONNECTED)
    await flows()


async def test_lists_topics(suite: Suite) -> None:
    """Without rosapi nothing is known of the far graph, and nothing fails."""
    client = await suite.client()
    assert client.topics() == {}
    assert client.state is LinkState.CONNECTED
