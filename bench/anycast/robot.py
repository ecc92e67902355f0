"""The robot of the bench: its gateway has the machines as a group, and its node sends frames and calls.

``python -m bench.anycast.robot`` reads a JSON object per line, does what it says, and prints what came of it as a line.
Times are of the machine's monotonic clock, which all processes share.
"""

from __future__ import annotations

import asyncio
import itertools
import json
import resource
import sys
import time
from collections.abc import AsyncIterator, Sequence
from contextlib import asynccontextmanager
from typing import Any, Final

from bench.anycast.machine import CALL, FOUND, FRAME
from ropeway.errors import CallError
from ropeway.gateway.config import config
from ropeway.gateway.gateway import Gateway
from ropeway.graph.base import Sample
from ropeway.graph.calls import Request
from ropeway.networks.memory.graph import MemoryGraph
from ropeway.types import TypeRegistry

CONNECT_S: Final = 20.0
DEPTH: Final = 100  # of what waits for the link: no frame is left out for a newer one
SETTLE_S: Final = 0.5  # for the last answers
REGISTRY: Final = TypeRegistry()
_numbers = itertools.count()


class Robot:
    """A robot with a group of machines."""

    def __init__(self, node: MemoryGraph, gateway: Gateway) -> None:
        self.node, self.gateway = node, gateway
        self.requests = 0
        self.sent: dict[int, float] = {}
        self.answers: dict[int, list[float]] = {}
        self._codec, self._found = REGISTRY.codec(FRAME), REGISTRY.codec(FOUND)

    @property
    def group(self) -> Any:
        """The group of the gateway, or the graph of its only link."""
        return self.gateway.remotes[0].graph

    async def begin(self, machines: int) -> None:
        """Wait until everything crosses."""
        self.camera = await self.node.create_publisher("/camera", FRAME)
        await self.node.create_subscription("/found", FOUND, None, self._came)
        self.client = await self.node.create_client("/find", CALL)
        loop = asyncio.get_running_loop()
        ends = loop.time() + CONNECT_S
        while loop.time() < ends:
            status = self.gateway.status()["remotes"][0]
            here = status.get("group", {}).get("members", {}).values()
            ready = sum(member["here"] for member in here) == machines or (machines == 1 and not here)
            if ready and (self.camera.subscribers or 0) > 0 and await self.client.wait_available(0.1):
                return
            await asyncio.sleep(0.02)
        raise SystemExit("the machines were not reached")

    def _came(self, batch: Sequence[Sample]) -> None:
        now = time.monotonic()
        for sample in batch:
            number = self._found.decode(sample.payload)["header"]["stamp"]["nanosec"]
            self.answers.setdefault(number, []).append(now)

    def frame(self, video_s: float, size: int = 4000) -> int:
        """Send a frame that takes ``video_s`` wherever it is looked at."""
        number = next(_numbers) + 1
        header = {"stamp": {"sec": 1, "nanosec": number}}
        payload = self._codec.encode({"header": header, "format": f"{video_s:.6f}", "data": bytes(size)})
        self.sent[number] = time.monotonic()
        self.camera.publish(Sample(payload, FRAME, number, bytes(16), number))
        return number

    def count(self) -> None:
        """Count the requests that go to members, each copy of its own."""
        scheduler = getattr(self.group, "scheduler", None)
        if scheduler is None:
            return
        asked = scheduler.asked

        def counted(names: Sequence[str], key: Any, now_s: float) -> None:
            self.requests += len(names)
            asked(names, key, now_s)

        scheduler.asked = counted

    def switch(self) -> None:
        """Change the machine by hand."""
        scheduler = self.group.scheduler
        scheduler.switch(next(n for n in scheduler.here if n != scheduler.current), self.group.now())

    def latency_s(self, number: int) -> float | None:
        """Return how long the first answer to a frame took."""
        came = self.answers.get(number)
        return came[0] - self.sent[number] if came else None


@asynccontextmanager
async def robot(addresses: Sequence[str], anycast: dict[str, Any] | None) -> AsyncIterator[Robot]:
    """Begin a robot whose gateway has these addresses; one alone is no group."""
    name = f"robot{next(_numbers)}"
    remote: dict[str, Any] = {
        "address": list(addresses),
        "publish": [{"name": "/camera", "type": FRAME, "depth": DEPTH}],
        "subscribe": [{"name": "/found", "type": FOUND, "depth": DEPTH}],
        "reserve-service": [{"name": "/find", "type": CALL}],
    }
    if len(addresses) > 1:
        remote["anycast"] = {"responses": {"/camera": "/found"}} | (anycast or {})
    settings = {"name": name, "graphs": [f"memory:{name}"], "listen": [], "control": False}
    async with Gateway(config.parse({"gateway": settings, "remotes": [remote]})) as gateway:
        node = MemoryGraph(name, node="/robot")
        await node.open()
        made = Robot(node, gateway)
        await made.begin(len(addresses))
        yield made
        await node.close()


async def frames(asked: dict[str, Any]) -> dict[str, Any]:
    """Send frames at a rate; ``video_s`` has what each takes. ``switch_at``: change by hand before this one."""
    async with robot(asked["addresses"], asked.get("anycast")) as made:
        print("begun", flush=True)
        numbers, period_s = [], 1 / asked["hz"]
        begins = time.monotonic()
        for index, video_s in enumerate(asked["video_s"]):
            await asyncio.sleep(max(0.0, begins + index * period_s - time.monotonic()))
            if index == asked.get("switch_at"):
                made.switch()
            numbers.append(made.frame(video_s))
        await asyncio.sleep(asked.get("settle_s", SETTLE_S))
        first = sorted(came[0] for came in made.answers.values())
        made_by = made.group.scheduler.decisions if len(asked["addresses"]) > 1 else ()
        decisions = [(d.at_s, d.before, d.after, d.why) for d in made_by]
        return {
            "sent": [made.sent[n] for n in numbers],
            "latency_s": [made.latency_s(n) for n in numbers],
            "answered": first,
            "twice": sum(len(came) > 1 for came in made.answers.values()),
            "ordered": all(a <= b for a, b in itertools.pairwise(made.answers)),
            "decisions": decisions,
        }


async def calls(asked: dict[str, Any]) -> dict[str, Any]:
    """Call again and again, ``hz`` times a second or one after the other, after so many ``warm`` calls."""
    async with robot(asked["addresses"], asked.get("anycast")) as made:
        made.count()
        print("begun", flush=True)
        took: list[tuple[float, float]] = []
        errors: list[str] = []

        async def one() -> None:
            began = time.monotonic()
            try:
                await made.client.call(Request(b"\x00\x01\x00\x00\x00", timeout_s=10.0), 10.0)
            except CallError as error:
                errors.append(f"{began:.3f} {error}")
            else:
                took.append((began, time.monotonic() - began))

        for _ in range(asked.get("warm", 0)):
            await one()
        took.clear()
        cpu, begins = resource.getrusage(resource.RUSAGE_SELF), time.monotonic()
        under_way: set[asyncio.Task[None]] = set()
        for index in range(asked["count"]):
            if asked.get("hz"):
                await asyncio.sleep(max(0.0, begins + index / asked["hz"] - time.monotonic()))
                task = asyncio.create_task(one())
                under_way.add(task)
                task.add_done_callback(under_way.discard)
            else:
                await one()
        if under_way:
            await asyncio.wait(under_way)
        after = resource.getrusage(resource.RUSAGE_SELF)
        used_s = after.ru_utime + after.ru_stime - cpu.ru_utime - cpu.ru_stime
        requests = made.requests if len(asked["addresses"]) > 1 else asked["count"]
        return {"requests": requests, "took": took, "errors": errors, "cpu_s": used_s}


def main() -> None:
    """Do what each line says."""
    for line in sys.stdin:
        asked = json.loads(line)
        work = {"frames": frames, "calls": calls}[asked["do"]]
        print(json.dumps(asyncio.run(work(asked))), flush=True)


if __name__ == "__main__":
    main()
