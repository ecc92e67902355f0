"""The ends of a measurement, each a process: a source and a sink on DDS, and a rosbridge client that is not ours.

A topic is written ``NAME:KIND:HZ``. Every role prints a line once it is ready, is then told the window that counts on
its standard input, two times on the clock of the machine, and prints what it saw as one JSON object.
"""

from __future__ import annotations

import argparse
import asyncio
import json
import sys
import time
from collections.abc import Awaitable, Callable
from typing import Any, NamedTuple

import cbor2
import uvloop
from picows import WSFrame, WSListener, WSMsgType, WSTransport, ws_connect

from bench.peers import STAMP, messages, restamp
from ropeway.graph.base import SEQ_NONE, Sample
from ropeway.networks.dds import DdsGraph
from ropeway.qos import QoS

__all__ = ["Topic", "quiet_end", "window"]

MATCH_S = 20.0  # whoever reads at the far end has been found by then, or will not be
COMMAND_PHASE_S = 0.0015  # a command is never due while the source is busy with an image
IDLE_S = 1.5  # nothing has come for so long after the end: nothing will


class Topic(NamedTuple):
    """What is sent: recorded images (``rgb``, ``depth``) or a ``command``, so many a second."""

    name: str
    kind: str
    hz: float

    @classmethod
    def parse_all(cls, text: str) -> list[Topic]:
        """Read ``NAME:KIND:HZ,…``."""
        return [cls(name, kind, float(hz)) for name, kind, hz in (item.split(":") for item in text.split(","))]

    def __str__(self) -> str:
        return f"{self.name}:{self.kind}:{self.hz:g}"

    @property
    def type(self) -> str:
        """Return its message type."""
        return "geometry_msgs/msg/TwistStamped" if self.kind == "command" else "sensor_msgs/msg/Image"

    def messages(self) -> list[bytes]:
        """Return its messages, to be sent in turn."""
        if self.kind == "command":  # 100 bytes: encapsulation, stamp, a name of 36 bytes, two vectors
            return [b"\0\1\0\0" + bytes(8) + b"\x24\0\0\0" + b"a" * 35 + b"\0" + bytes(48)]
        return messages(self.kind)[1]


async def window() -> tuple[float, float]:
    """Wait for the times between which it counts."""
    line = await asyncio.get_running_loop().run_in_executor(None, sys.stdin.readline)
    began, ended = map(float, line.split())
    return began, ended


async def quiet_end(ended: float, drain_s: float, last: Callable[[], float]) -> None:
    """Wait until what was on the way at the end has come: nothing comes any more, or the patience is over."""
    await asyncio.sleep(max(0.0, ended - time.time()))
    while time.time() < ended + drain_s and time.time() - max(last(), ended) < IDLE_S:
        await asyncio.sleep(0.05)


async def source(args: argparse.Namespace) -> None:
    """Publish; tell how many messages of each topic were sent within the window."""
    graph = DdsGraph(args.domain, name="source", interface="lo")
    await graph.open()
    topics = Topic.parse_all(args.topics)
    recorded = [topic.messages() for topic in topics]
    publishers = [await graph.create_publisher(topic.name, topic.type, QoS()) for topic in topics]
    deadline = time.time() + MATCH_S
    while not all(p.subscribers for p in publishers) and time.time() < deadline:
        await asyncio.sleep(0.02)
    await asyncio.sleep(0.5)
    told = asyncio.ensure_future(window())
    sent: dict[str, list[float]] = {topic.name: [] for topic in topics}
    began = asyncio.get_running_loop().time() + 0.05

    async def run(topic: Topic, publisher: Any, payloads: list[bytes]) -> None:
        loop, first = asyncio.get_running_loop(), began + (COMMAND_PHASE_S if topic.kind == "command" else 0.0)
        number = 0
        while True:
            await asyncio.sleep(max(0.0, first + number / topic.hz - loop.time()))
            number = max(number, int((loop.time() - first) * topic.hz)) + 1  # what was missed is not made up for
            now = time.time_ns()
            if told.done() and now / 1e9 >= told.result()[1]:
                return
            publisher.publish(
                Sample(restamp(payloads[number % len(payloads)], now), topic.type, now, bytes(16), SEQ_NONE)
            )
            sent[topic.name].append(now / 1e9)

    print("started", flush=True)
    await asyncio.gather(*map(run, topics, publishers, recorded))
    print(json.dumps(sent), flush=True)
    await asyncio.sleep(args.drain + 1)  # what a reader missed is sent again
    await graph.close()


async def sink(args: argparse.Namespace) -> None:
    """Read; tell when each message was stamped, when it came, and how long it was."""
    graph = DdsGraph(args.domain, name="sink", interface="lo")
    await graph.open()
    rows: dict[str, list[tuple[float, float, int]]] = {}
    for topic in Topic.parse_all(args.topics):
        mine = rows[topic.name] = []

        def receive(batch: list[Sample], mine: list[tuple[float, float, int]] = mine) -> None:
            now = time.time()
            for sample in batch:
                sec, nanosec = STAMP.unpack_from(sample.payload, 4)
                mine.append((sec + nanosec / 1e9, now, len(sample.payload)))

        await graph.create_subscription(topic.name, topic.type, QoS(), receive)
    await collect(args, rows)
    await graph.close()


async def client(args: argparse.Namespace) -> None:
    """Read as a rosbridge client does that knows nothing of Ropeway, with ``--compression``."""
    topics = Topic.parse_all(args.topics)
    rows: dict[str, list[tuple[float, float, int]]] = {topic.name: [] for topic in topics}
    _, listener = await _dial(f"ws://{args.host}:{args.port}", rows)
    for topic in topics:
        listener.subscribe(topic, args.compression)
    await collect(args, rows)


async def _dial(url: str, rows: dict[str, list[tuple[float, float, int]]]) -> tuple[WSTransport, _Client]:
    for _ in range(200):
        try:
            return await ws_connect(lambda: _Client(rows), url, max_frame_size=64 << 20)
        except OSError:
            await asyncio.sleep(0.1)
    raise SystemExit(f"nobody answers at {url}")


class _Client(WSListener):
    def __init__(self, rows: dict[str, list[tuple[float, float, int]]]) -> None:
        self._rows = rows
        self._transport: WSTransport | None = None

    def subscribe(self, topic: Topic, compression: str) -> None:
        assert self._transport is not None
        operation = {"op": "subscribe", "topic": topic.name, "type": topic.type, "compression": compression}
        self._transport.send(WSMsgType.TEXT, json.dumps(operation).encode())

    def on_ws_connected(self, transport: WSTransport) -> None:
        self._transport = transport

    def on_ws_frame(self, transport: WSTransport, frame: WSFrame) -> None:
        now = time.time()
        if frame.msg_type == WSMsgType.TEXT:
            operation = json.loads(frame.get_payload_as_memoryview().tobytes())
        elif frame.msg_type == WSMsgType.BINARY:
            operation = cbor2.loads(frame.get_payload_as_bytes())
        else:
            return
        if operation.get("op") != "publish":
            return
        message = operation["msg"]
        if isinstance(message.get("bytes"), bytes):  # cbor-raw
            sec, nanosec = STAMP.unpack_from(message["bytes"], 4)
        else:
            stamp = message["header"]["stamp"]
            sec, nanosec = stamp["sec"], stamp["nanosec"]
        self._rows[operation["topic"]].append((sec + nanosec / 1e9, now, len(frame.get_payload_as_memoryview())))


async def collect(args: argparse.Namespace, rows: dict[str, list[tuple[float, float, int]]]) -> None:
    """Say that it is ready, wait for the end of the window and of what is on the way, and tell what came."""
    print("ready", flush=True)
    _, ended = await window()
    await quiet_end(ended, args.drain, lambda: max((mine[-1][1] for mine in rows.values() if mine), default=0.0))
    print(json.dumps(rows), flush=True)


def main() -> None:
    """The command line."""
    roles: dict[str, Callable[[argparse.Namespace], Awaitable[None]]]
    roles = {"source": source, "sink": sink, "client": client}
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("role", choices=list(roles))
    parser.add_argument("--topics", required=True)
    parser.add_argument("--domain", type=int, default=0)
    parser.add_argument("--drain", type=float, default=5.0)
    parser.add_argument("--host", default="")
    parser.add_argument("--port", type=int, default=9090)
    parser.add_argument("--compression", default="none")
    args = parser.parse_args()
    uvloop.run(roles[args.role](args))


if __name__ == "__main__":
    main()
