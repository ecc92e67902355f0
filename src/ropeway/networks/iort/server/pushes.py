"""The values that wait for one node: of each topic the newest, and as many topics as there is room for."""

from __future__ import annotations

from collections.abc import Callable
from typing import Final

from ropeway.delivery.outbox import Outbox, Queue
from ropeway.limits import NODE_WAITING_BYTES
from ropeway.store import Entry

__all__ = ["Pushes"]

_LANE: Final = 4


class _Push:
    """A value that waits; ``latest`` tells whether it is one that was there before the node asked."""

    __slots__ = ("entry", "latest", "payload", "stamp_ns")

    def __init__(self, entry: Entry, latest: bool) -> None:
        self.entry, self.latest = entry, latest
        self.payload, self.stamp_ns = entry.data, entry.stamp_ns


class Pushes:
    """Keeps what waits; ``superseded`` is called for each value that gave way to another."""

    __slots__ = ("_outbox", "_queues", "_superseded")

    def __init__(self, superseded: Callable[[], None]) -> None:
        self._outbox: Outbox[_Push] | None = None  # 2.5 kB, and most of thousands of nodes never have anything waiting
        self._queues: dict[tuple[str, str], Queue[_Push]] = {}
        self._superseded = superseded

    def __bool__(self) -> bool:
        """Tell whether anything waits."""
        return bool(self._queues)

    @property
    def bytes(self) -> int:
        """The number of bytes that wait."""
        return 0 if self._outbox is None else self._outbox.bytes

    def put(self, entry: Entry, latest: bool) -> None:
        """Let a value wait, in the place of the one of its topic that waits."""
        key = entry.key
        if self._outbox is None:
            self._outbox = Outbox()
        outbox = self._outbox
        queue = self._queues.get(key)
        if queue is None:
            queue = self._queues[key] = outbox.open(Queue(key, depth=1))
        elif queue.waiting:
            self._superseded()
        outbox.put(queue, _Push(entry, latest))
        while outbox.bytes > NODE_WAITING_BYTES and len(self._queues) > 1:
            self._drop(next(other for other in self._queues if other != key))
            self._superseded()

    def take(self) -> tuple[Entry, bool] | None:
        """Take the value whose turn it is: topics share by bytes."""
        outbox = self._outbox
        taken = None if outbox is None else outbox.take(_LANE, 0)
        if outbox is None or taken is None:
            return None
        queue, push = taken
        outbox.served(queue, len(push.payload))
        outbox.done(queue)
        self._drop(push.entry.key)
        return push.entry, push.latest

    def clear(self) -> None:
        """Forget everything that waits."""
        for key in list(self._queues):
            self._drop(key)

    def _drop(self, key: tuple[str, str]) -> None:
        queue = self._queues.pop(key)
        if self._outbox is not None:
            self._outbox.close(queue)
