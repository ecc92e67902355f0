"""Sends what publishers have: the freshest of every topic, sealed when its lane is free and not before."""

from __future__ import annotations

import asyncio
import logging
import time
from collections import deque
from collections.abc import Sequence
from functools import partial
from typing import TYPE_CHECKING, Final, cast

from ropeway.errors import GraphUnavailable
from ropeway.graph.base import Sample, Undelivered
from ropeway.link.outbox import LANES, Outbox, Queue
from ropeway.overlay.item import Item
from ropeway.tasks import Supervised, end

if TYPE_CHECKING:
    from ropeway.graph.overlay.graph import OverlayGraph
    from ropeway.graph.overlay.publisher import OverlayPublisher

__all__ = ["Sender"]

log = logging.getLogger("ropeway.graph.overlay")

_BATCH_BYTES: Final = 64 * 1024
_BATCH: Final = 256
_ITEM_BYTES: Final = 64  # what a message costs beside its payload
_FLUSH_S: Final = 2.0

Job = tuple["OverlayPublisher", list[Item]]


class Sender:
    """One task per lane takes from the outbox what may go now, and hands it to the lane's thread."""

    def __init__(self, graph: OverlayGraph) -> None:
        self._graph = graph
        self._outbox: Outbox[Sample] = Outbox()
        self._wake = [asyncio.Event() for _ in range(LANES)]
        self._tasks: dict[int, Supervised] = {}
        self._busy: dict[int, bool] = {}
        self._idle = asyncio.Event()

    def open(self, queue: Queue[Sample]) -> None:
        """Let a publisher use it."""
        self._outbox.open(queue)

    def drop(self, queue: Queue[Sample]) -> None:
        """A publisher has left; what waits is lost."""
        self._outbox.close(queue)

    def put(self, queue: Queue[Sample], sample: Sample) -> None:
        """Let a message wait for its lane."""
        self._outbox.put(queue, sample)
        lane = queue.priority
        self._wake[lane].set()
        if lane not in self._tasks:
            self._tasks[lane] = Supervised(partial(self._run, lane), f"overlay lane {lane}").start()

    async def flush(self, queue: Queue[Sample]) -> None:
        """Wait until a publisher has nothing waiting, for a little while."""
        try:
            async with asyncio.timeout(_FLUSH_S):
                while queue.waiting or self._busy.get(queue.priority):
                    self._idle.clear()
                    await self._idle.wait()
        except TimeoutError:
            log.debug("overlay: %s has left with %d messages unsent", self._graph.name, len(queue.waiting))

    async def close(self) -> None:
        """Send nothing more."""
        await end(*self._tasks.values())
        self._tasks.clear()
        self._outbox.clear()

    async def _run(self, lane: int) -> None:
        """Hand over batch after batch; of small messages the next is made ready while one is sealed."""
        wake = self._wake[lane]
        under_way: deque[tuple[list[Job], asyncio.Future[None]]] = deque()
        jobs: list[Job] = []
        while True:
            if not under_way and not jobs:
                await wake.wait()
            wake.clear()
            jobs, small = self._gather(lane)
            if jobs:
                self._busy[lane] = True
                under_way.append((jobs, self._graph.node.fabric.in_lane(lane, partial(self._send, lane, jobs))))
            while under_way and (not jobs or not small or len(under_way) > 1):
                await self._sent(*under_way.popleft())
            if not under_way and not jobs:
                self._busy[lane] = False
                self._idle.set()

    async def _sent(self, jobs: list[Job], sending: asyncio.Future[None]) -> None:
        try:
            await sending
        except GraphUnavailable:
            self._lost(jobs, Undelivered.CLOSED)
        except Exception:  # sealing and sending are libraries' work; one message must not end the lane
            log.exception("overlay: %s cannot send", self._graph.name)
            self._lost(jobs, Undelivered.WRITE)

    def _lost(self, jobs: list[Job], reason: Undelivered) -> None:
        for publisher, items in jobs:
            self._graph.drops[publisher.topic, reason] += len(items)

    def _gather(self, lane: int) -> tuple[list[Job], bool]:
        """What goes in one turn, by publisher; and whether it is of small messages."""
        found: dict[OverlayPublisher, list[Item]] = {}
        size = count = 0
        while size < _BATCH_BYTES and count < _BATCH:
            taken = self._outbox.take(lane, time.time_ns())
            if taken is None:
                break
            queue, sample = taken
            publisher = cast("OverlayPublisher", queue.key)
            items = found.get(publisher)
            if items is None:
                items = found[publisher] = []
            items.append(publisher.add(sample))
            self._outbox.served(queue, len(sample.payload) + _ITEM_BYTES)
            self._outbox.done(queue)
            size += len(sample.payload)
            count += 1
        return list(found.items()), size <= 2 * _BATCH_BYTES

    def _send(self, lane: int, jobs: Sequence[Job]) -> None:
        """In the lane's thread."""
        for publisher, items in jobs:
            packet = publisher.source.seal([publisher.packing.pack(item) for item in items])
            began = time.perf_counter()
            self._graph.node.fabric.put(lane, publisher.wire_key(), packet)
            publisher.packing.sent(len(packet), time.perf_counter() - began)
