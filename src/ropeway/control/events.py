"""Tells readers what happens in the gateway: a bounded ring of events, and a bounded queue for each reader."""

from __future__ import annotations

import asyncio
import itertools
import time
from collections import deque
from collections.abc import AsyncGenerator
from dataclasses import dataclass
from typing import Any, Final

import orjson

from ropeway import aio
from ropeway.limits import CONTROL_EVENT_BYTES, CONTROL_EVENTS_KEPT, CONTROL_READER_BYTES

__all__ = ["Event", "Events"]

_OVERHEAD_BYTES: Final = 256  # of an event without its data: numbers, kind, name


@dataclass(frozen=True, slots=True)
class Event:
    """An event: ``kind`` such as ``config`` or ``route``, the ``name`` of the object, and more."""

    number: int
    time_s: float
    kind: str
    name: str
    data: dict[str, Any]
    size_bytes: int

    def to_json(self) -> dict[str, Any]:
        """Return the event as JSON."""
        return {"number": self.number, "time": self.time_s, "kind": self.kind, "name": self.name, **self.data}


class _Reader:
    """The events that wait for one reader."""

    def __init__(self) -> None:
        self.waiting: deque[Event] = deque()
        self.bytes = 0
        self.changed = asyncio.Event()
        self.dropped = False


class Events:
    """Keeps the last events, and hands new ones to readers; a reader that takes too long is dropped, and counted."""

    def __init__(self, *, kept: int = CONTROL_EVENTS_KEPT, reader_bytes: int = CONTROL_READER_BYTES) -> None:
        self.dropped_readers = 0
        self._numbers = itertools.count(1)
        self._ring: deque[Event] = deque(maxlen=kept)
        self._readers: set[_Reader] = set()
        self._reader_bytes = reader_bytes
        self._closed = False

    def tell(self, kind: str, name: str, **data: Any) -> Event:
        """Record an event and hand it to all readers. An event with too much data is told without it."""
        size = len(orjson.dumps(data, option=orjson.OPT_NON_STR_KEYS, default=str)) + _OVERHEAD_BYTES
        if size > CONTROL_EVENT_BYTES:
            data, size = {"left_out_bytes": size}, _OVERHEAD_BYTES
        event = Event(next(self._numbers), time.time(), kind, name, data, size)
        self._ring.append(event)
        for reader in list(self._readers):
            reader.waiting.append(event)
            reader.bytes += size
            if reader.bytes > self._reader_bytes:
                self._drop(reader)
            reader.changed.set()
        return event

    def last(self, *, after: int = 0, name: str = "") -> list[Event]:
        """Return the events that are kept, oldest first: those behind number ``after``, of ``name`` alone if given."""
        return [event for event in self._ring if event.number > after and (not name or event.name == name)]

    @property
    def readers(self) -> int:
        """The number of readers."""
        return len(self._readers)

    async def follow(
        self, *, after: int | None = None, idle_s: float | None = None
    ) -> AsyncGenerator[Event | None, None]:
        """Yield new events until the gateway ends or the reader is too slow; first those behind number ``after``.

        ``None`` comes where nothing happened for ``idle_s``.
        """
        reader = _Reader()
        if after is not None:
            reader.waiting.extend(self.last(after=after))
        self._readers.add(reader)
        try:
            while True:
                while reader.waiting:
                    event = reader.waiting.popleft()
                    reader.bytes = max(reader.bytes - event.size_bytes, 0)
                    yield event
                if self._closed or reader.dropped:
                    return
                reader.changed.clear()
                try:
                    async with aio.timeout(idle_s):
                        await reader.changed.wait()
                except TimeoutError:
                    yield None
        finally:
            self._readers.discard(reader)

    def close(self) -> None:
        """End all readers."""
        self._closed = True
        for reader in self._readers:
            reader.changed.set()

    def _drop(self, reader: _Reader) -> None:
        self.dropped_readers += 1
        self._readers.discard(reader)
        reader.waiting.clear()
        reader.dropped = True
