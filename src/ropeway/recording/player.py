"""Publishes a recording at its own pace, as ``ropeway play`` and ``ropeway demo --bag`` do.

A thread reads ahead by a bounded number of bytes, so that decompression never delays a message; due times are
absolute, so that nothing drifts.
"""

from __future__ import annotations

import asyncio
import itertools
import math
import struct
import time
from collections import Counter, deque
from collections.abc import AsyncGenerator, AsyncIterator, Callable, Collection, Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import AbstractAsyncContextManager, aclosing, nullcontext
from dataclasses import dataclass, field
from typing import Final

from ropeway import aio
from ropeway.errors import TypesError
from ropeway.graph.base import SEQ_NONE, Graph, Publisher, Sample, new_origin
from ropeway.qos import QoS
from ropeway.recording.bag import Bag, BagTopic, Record
from ropeway.recording.recorded_clock import RecordedClock
from ropeway.recording.ring import MOST_LATCHED
from ropeway.types.definition import HEADER, FieldType

__all__ = ["MAX_GAP_S", "Patiently", "PlaybackSchedule", "Played", "play", "read_ahead", "restamped", "silently"]

MAX_GAP_S: Final = 60.0
"""The longest pause that is played as it was recorded. Longer ones are seldom meant: a recorder that was stopped, a
clock that was set, a stamp of 1970 or 2262."""

_JUMP_S: Final = 1.0  # how long a longer pause is played

_BATCH_BYTES: Final = 8 << 20  # two of them at most are held: the one that plays and the one that is read
_BATCH_RECORDS: Final = 512
_BREATHER: Final = 16  # messages after which others get the loop, where the player is behind

_LITTLE: Final = struct.Struct("<iI")
_BIG: Final = struct.Struct(">iI")


Patiently = Callable[[Callable[[], str]], AbstractAsyncContextManager[object]]
"""Makes a block that waits, and that may say what it waits for: the function gives the sentence as things stand."""


def silently(waiting_for: Callable[[], str]) -> AbstractAsyncContextManager[object]:
    """Say nothing of what is waited for."""
    return nullcontext()


@dataclass
class Played:
    """The progress of playing a recording."""

    messages: int = 0
    bytes: int = 0
    position_s: float = 0.0
    rounds: int = 0
    jumps: int = 0
    longest_jump_s: float = 0.0
    by_topic: Counter[str] = field(default_factory=Counter)


class PlaybackSchedule:
    """Decides when each message of a round is due, counted from its first.

    Stamps that lie further apart than ``max_gap_s``, forwards or backwards, are no pause that anybody wants to wait
    for: the message comes a second after the one before (at once, where time went back). ``jumps`` counts them, and
    ``longest_s`` is the longest.
    """

    def __init__(self, max_gap_s: float) -> None:
        self.jumps = 0
        self.longest_s = 0.0
        self.due_s = 0.0
        self._max_gap_s = max_gap_s
        self._base_ns: int | None = None
        self._base_s = 0.0
        self._last_ns = 0

    def due(self, time_ns: int) -> float:
        """Return when the message of this time is due."""
        if self._base_ns is None:
            self._base_ns = self._last_ns = time_ns
        gap_s = (time_ns - self._last_ns) / 1e9
        if abs(gap_s) > self._max_gap_s:
            self.jumps += 1
            self.longest_s = max(self.longest_s, abs(gap_s))
            self._base_ns, self._base_s = time_ns, self.due_s + (_JUMP_S if gap_s > 0 else 0.0)
        self._last_ns = time_ns
        self.due_s = max(self.due_s, self._base_s + (time_ns - self._base_ns) / 1e9)
        return self.due_s


def restamped(payload: bytes, now_ns: int) -> bytes:
    """Return the message with ``now_ns`` as the stamp of the header that it begins with."""
    sec, nanosec = divmod(now_ns, 1_000_000_000)
    stamp = (_LITTLE if payload[1] & 1 else _BIG).pack(sec, nanosec)
    return b"".join((payload[:4], stamp, memoryview(payload)[12:]))


async def read_ahead(records: Iterator[Record]) -> AsyncGenerator[list[Record], None]:
    """Yield batches of records; while one is in use, a thread reads the next."""

    def take() -> list[Record]:
        batch: list[Record] = []
        size = 0
        for record in itertools.islice(records, _BATCH_RECORDS):
            batch.append(record)
            size += len(record.payload)
            if size >= _BATCH_BYTES:
                break
        return batch

    loop = asyncio.get_running_loop()
    with ThreadPoolExecutor(1, "ropeway-bag") as thread:
        coming = loop.run_in_executor(thread, take)
        try:
            while batch := await coming:
                coming = loop.run_in_executor(thread, take)
                yield batch
        finally:
            await asyncio.wait([coming])


def _starts_with_header(bag: Bag, topic: BagTopic) -> bool:
    try:
        first = bag.registry.definition(topic.type).wire_fields[:1]
    except TypesError:  # played as bytes
        return False
    return bool(first) and first[0].type == FieldType(HEADER)


async def _readers(publishers: Collection[Publisher], wait_s: float, patiently: Patiently) -> None:
    """Wait until somebody reads each topic, at most ``wait_s``."""
    waiting = {id(p): p.topic for p in publishers if p.subscribers == 0}
    done = asyncio.Event()

    def watch(publisher: Publisher) -> None:
        def changed(count: int) -> None:
            if count:
                waiting.pop(id(publisher), None)
            if not waiting:
                done.set()

        publisher.on_demand(changed)

    for publisher in publishers:
        watch(publisher)
    if not waiting:
        return
    try:
        said = patiently(lambda: f"waiting {wait_s:g} s at most for readers of {', '.join(sorted(waiting.values()))}")
        async with said, aio.timeout(wait_s):
            await done.wait()
    except TimeoutError:
        return


def as_recorded(qos: QoS) -> QoS:
    """Return what was recorded."""
    return qos


async def play(
    graph: Graph,
    bag: Bag,
    *,
    topics: Collection[str] = (),
    rate: float = 1.0,
    loop: bool = False,
    restamp: bool = False,
    for_s: float | None = None,
    wait_s: float = 0.0,
    max_gap_s: float = MAX_GAP_S,
    start_s: float = 0.0,
    offer: Callable[[QoS], QoS] = as_recorded,
    clock_hz: float = 0.0,
    rename: Callable[[str], str] = str,
    told: Callable[[Played], None] = lambda played: None,
    patiently: Patiently = silently,
) -> Played:
    """Publish the recording on ``graph``; returns what was played.

    ``rate`` is how much faster than recorded; ``for_s`` ends it after so many seconds (``None``: at its end);
    ``wait_s`` is how long to wait for subscribers first; ``max_gap_s`` the longest pause kept (``PlaybackSchedule``);
    ``start_s`` leaves out what comes before that time of the recording, but for what is latched, which is published
    first; ``restamp`` puts the time of sending into headers; ``offer`` makes QoS of what was recorded;
    ``clock_hz`` publishes the time of the recording on ``/clock`` so often; ``rename`` gives topics other names;
    ``told`` is called after each message; ``patiently`` wraps what is waited for once.
    """
    chosen = [topic for topic in bag.topics if not topic.problem and (not topics or topic.name in topics)]
    publishers = {t: await graph.create_publisher(rename(t.name), t.type, offer(t.qos)) for t in chosen}
    ticks = await RecordedClock.on(graph, bag, clock_hz, rate) if clock_hz else None
    stamped = {topic for topic in chosen if restamp and _starts_with_header(bag, topic)}
    origin, played, before_s = new_origin(), Played(), 0.0
    clock = asyncio.get_running_loop()
    try:
        await _readers(publishers.values(), wait_s, patiently)
        began = 0.0
        ends = math.inf
        while chosen:
            pace, first = PlaybackSchedule(max_gap_s), played.messages
            async with aclosing(read_ahead(bag.records(topics))) as batches:
                async for record in _from(_flat(batches), bag.start_ns + int(start_s * 1e9)):
                    if not played.messages:  # the clock starts when the first batch has been read
                        began = clock.time()
                        ends = math.inf if for_s is None else began + for_s
                    offset_s = pace.due(record.time_ns)
                    due = began + (before_s + offset_s) / rate
                    if ticks is not None:
                        await ticks.until(record.time_ns, due, ends)
                    left = min(due, ends) - clock.time()
                    if left > 0 or played.messages % _BREATHER == 0:
                        await asyncio.sleep(max(left, 0))
                    if due >= ends:
                        return played
                    now_ns = time.time_ns()
                    payload = restamped(record.payload, now_ns) if record.topic in stamped else record.payload
                    publishers[record.topic].publish(Sample(payload, record.topic.type, now_ns, origin, SEQ_NONE))
                    played.messages += 1
                    played.bytes += len(payload)
                    played.position_s = offset_s
                    played.by_topic[record.topic.name] += 1
                    played.jumps, played.longest_jump_s = pace.jumps, pace.longest_s
                    told(played)
            played.rounds += 1
            before_s += _round_s(pace.due_s, played.messages - first)
            if not loop or not played.messages:
                break
        return played
    finally:
        for publisher in publishers.values():
            await publisher.close()
        if ticks is not None:
            await ticks.close()


async def _from(records: AsyncIterator[Record], start_ns: int) -> AsyncIterator[Record]:
    """Leave out what comes before a time, but for the last messages of latched topics, which come first."""
    latched: dict[BagTopic, deque[Record]] = {}
    begun = False
    async for record in records:
        if not begun and record.time_ns < start_ns:
            if record.topic.qos.transient_local:
                kept = latched.setdefault(record.topic, deque(maxlen=min(record.topic.qos.depth or 1, MOST_LATCHED)))
                kept.append(record._replace(time_ns=start_ns))
            continue
        if not begun:
            begun = True
            for kept in latched.values():
                for one in kept:
                    yield one
        yield record


async def _flat(batches: AsyncIterator[list[Record]]) -> AsyncIterator[Record]:
    async for batch in batches:
        for record in batch:
            yield record


def _round_s(duration_s: float, count: int) -> float:
    """Return how long one round of a loop takes: the recording, and a usual gap before it starts again."""
    return duration_s * count / (count - 1) if count > 1 and duration_s else 1.0
