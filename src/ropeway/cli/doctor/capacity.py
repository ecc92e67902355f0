"""Estimates what a gateway on this machine can carry: it has two pass messages on, and looks at the processor time."""

from __future__ import annotations

import asyncio
import contextlib
import os
import struct
import time
from collections.abc import Iterator, Sequence
from contextlib import AsyncExitStack
from pathlib import Path
from typing import Final, NamedTuple

from ropeway import aio
from ropeway.cli.doctor.symptom import Symptom
from ropeway.cli.loop import run
from ropeway.errors import RopewayError
from ropeway.gateway.config.config import parse
from ropeway.gateway.gateway import Gateway
from ropeway.graph.base import SEQ_NONE, Sample
from ropeway.networks.memory.graph import MemoryGraph

__all__ = ["Costs", "capacity", "measure", "processors"]

_TYPE: Final = "std_msgs/msg/UInt8MultiArray"
_HEAD: Final = b"\0\1\0\0"
_SMALL_BYTES: Final = 1000
_IMAGE_BYTES: Final = 300_000  # 424 by 240 pixels in colour
_BURST: Final = 50
_ROUNDS: Final = 5  # the least counts: whatever else runs here only adds
_PER_ROUND: Final = 100
_IMAGES_PER_ROUND: Final = 20
_PATIENCE_S: Final = 20.0  # on a machine that is busy, or has a small share of a processor
_LITTLE: Final = 0.1  # of a processor: starting takes ten seconds


class Costs(NamedTuple):
    """The processor time that one gateway spends on one message, in seconds."""

    alone_s: float
    burst_s: float
    image_s: float


def capacity(root: Path = Path("/")) -> Iterator[Symptom]:
    """Yield what a gateway could carry here; ``root`` is where /proc and /sys are."""
    share = processors(root)
    try:
        costs = run(measure())
    except (RopewayError, OSError, TimeoutError) as error:
        yield Symptom(None, "capacity", f"what a gateway can carry here could not be measured: {error or 'no time'}")
        return
    one = min(share, 1.0)  # a gateway has one event loop
    alone, burst = (round(one / cost, -2) for cost in (costs.alone_s, costs.burst_s))
    text = (
        f"{share:g} processors: a gateway passes on about {alone:,.0f} messages of 1 kB a second one by one, "
        f"{burst:,.0f} in bursts, or {one / costs.image_s * _IMAGE_BYTES / 1e6:,.0f} MB/s of images; "
        "a half to a third of that where it reads or writes DDS"
    )
    if share < _LITTLE:
        yield Symptom(None, "capacity", text, "give it more: CPUQuota= of the unit, or --cpus of the container")
    else:
        yield Symptom(True, "capacity", text)


def processors(root: Path = Path("/")) -> float:
    """Return how many processors this process may use, with what its control groups allow."""
    count = float(len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1)
    return min([count, *_quotas(root)])


def _quotas(root: Path) -> Iterator[float]:
    """Yield the limits of the control groups that this process is in, in processors; of version 1 and 2."""
    try:
        lines = (root / "proc/self/cgroup").read_text().splitlines()
    except OSError:
        return
    mounted = root / "sys/fs/cgroup"
    for line in lines:
        _, controllers, path = line.split(":", 2)
        if not controllers:
            top, files = mounted, ["cpu.max"]
        elif "cpu" in controllers.split(","):
            top, files = mounted / controllers, ["cpu.cfs_quota_us", "cpu.cfs_period_us"]
        else:
            continue
        own = top / path.strip("/")
        for folder in (own, *own.parents):
            if not folder.is_relative_to(top):
                break
            with contextlib.suppress(OSError, ValueError):  # the root has no limit
                quota, period = (int(number) for name in files for number in (folder / name).read_text().split())
                if quota > 0:
                    yield quota / period


async def measure() -> Costs:
    """Return what one message costs a gateway. Raises ``RopewayError``, or ``TimeoutError`` where nothing arrives."""
    async with AsyncExitStack() as stack:
        pair = await _GatewayPair.open(stack)
        return Costs(
            await pair.cost(_SMALL_BYTES, 1, _PER_ROUND),
            await pair.cost(_SMALL_BYTES, _BURST, _PER_ROUND),
            await pair.cost(_IMAGE_BYTES, 1, _IMAGES_PER_ROUND),
        )


class _GatewayPair:
    """Two gateways in this process, one of which forwards a topic to the other."""

    def __init__(self, near: MemoryGraph, far: MemoryGraph) -> None:
        self._near, self._far = near, far
        self._arrived = 0
        self._complete = asyncio.Event()
        self._wanted = 1

    @classmethod
    async def open(cls, stack: AsyncExitStack) -> _GatewayPair:
        """Bring both up, and wait until messages pass."""
        name = f"doctor-{os.getpid()}"
        near, far = f"memory:{name}-near", f"memory:{name}-far"
        listens = await stack.enter_async_context(
            Gateway(parse({"gateway": {"graphs": [far], "listen": ["ws://127.0.0.1:0"]}}))
        )
        route = {"name": "/capacity", "type": _TYPE, "compression": "cbor-raw"}
        remote = {"address": f"ws://127.0.0.1:{listens.servers[0].listeners[0].port}", "publish": [route]}
        await stack.enter_async_context(
            Gateway(parse({"gateway": {"graphs": [near], "listen": []}, "remotes": [remote]}))
        )
        pair = cls(MemoryGraph(f"{name}-near", node="/source"), MemoryGraph(f"{name}-far", node="/sink"))
        for graph in (pair._near, pair._far):
            await graph.open()
            stack.push_async_callback(graph.close)
        await pair._join()
        return pair

    async def _join(self) -> None:
        await self._far.create_subscription("/capacity", _TYPE, None, self._take)
        self._publisher = await self._near.create_publisher("/capacity", _TYPE)
        async with aio.timeout(_PATIENCE_S):
            while not self._arrived:  # until the route stands
                self._publisher.publish(_sample(1))
                await asyncio.sleep(0.01)

    def _take(self, batch: Sequence[Sample]) -> None:
        self._arrived += len(batch)
        if self._arrived >= self._wanted:
            self._complete.set()

    async def cost(self, size: int, burst: int, count: int) -> float:
        """Return the least processor time of one gateway per message of so many bytes, of rounds of ``count``."""
        sample, found = _sample(size), []
        for _ in range(_ROUNDS):
            began = time.process_time()
            for _ in range(count // burst):
                self._wanted = self._arrived + burst
                self._complete.clear()
                for _ in range(burst):
                    self._publisher.publish(sample)
                async with aio.timeout(_PATIENCE_S):
                    await self._complete.wait()
            found.append((time.process_time() - began) / count / 2)
        return min(found)


def _sample(size: int) -> Sample:
    return Sample(_HEAD + struct.pack("<III", 0, 0, size) + bytes(size), _TYPE, 0, bytes(16), SEQ_NONE)
