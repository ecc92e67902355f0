"""What waits to be sent on one link: priority lanes, and in each the freshest message of every topic.

A topic with ``keep_last`` may have ``depth`` messages waiting, and no more than 64 KiB unless it is a single one:
of a camera only the newest frame waits, of a transform tree everything does. What is displaced is the oldest, and
it is counted. A topic with ``keep_all`` waits in a first-in first-out queue that is bounded in bytes.

Which message to send is decided when the link can take it, never before.
"""

from __future__ import annotations

import enum
import heapq
import itertools
from collections import Counter, deque
from typing import TYPE_CHECKING, Final, Generic, NamedTuple, Protocol, TypeVar

if TYPE_CHECKING:
    from collections.abc import Iterator

__all__ = ["LANES", "Lost", "Outbox", "OutboxStatistics", "Queue"]

LANES: Final = 8
FRESH_BYTES: Final = 64 * 1024
KEEP_ALL_LIMIT_BYTES: Final = 16 << 20


class Lost(enum.Enum):
    """Why a message was not sent."""

    REPLACED = "a fresher one took its place"
    OVERFLOW = "the queue of the topic was full"
    EXPIRED = "it was older than the lifespan of its topic"
    UNSENT = "the link closed before it could be sent"
    ENCODE = "it could not be encoded"
    REPEATED = "its id had come before"


class Message(Protocol):
    """What the outbox needs to know of a message."""

    payload: bytes
    stamp_ns: int


M = TypeVar("M", bound=Message)


class OutboxStatistics(NamedTuple):
    """What waits now."""

    messages: int
    bytes: int
    topics: int


class Queue(Generic[M]):
    """The messages of one topic that wait on one link.

    ``depth`` counts messages, ``None`` means keep all (bounded in bytes); ``lifespan_ns`` is the age at which a
    waiting message is not worth sending; of a ``latched`` topic each of the last ``depth`` messages is wanted,
    whatever their size.
    """

    __slots__ = (
        "bytes",
        "depth",
        "key",
        "latched",
        "lifespan_ns",
        "limit_bytes",
        "lost",
        "number",
        "priority",
        "turn",
        "waiting",
    )

    def __init__(
        self,
        key: object,
        *,
        priority: int = 4,
        depth: int | None = 1,
        lifespan_ns: int | None = None,
        limit_bytes: int = KEEP_ALL_LIMIT_BYTES,
    ) -> None:
        self.key = key
        self.priority = min(max(priority, 0), LANES - 1)
        self.depth = None if depth is None else max(depth, 1)
        self.lifespan_ns = lifespan_ns
        self.limit_bytes = limit_bytes
        self.latched = False
        self.waiting: deque[M] = deque()
        self.bytes = 0
        self.number = self.turn = 0
        self.lost: Counter[Lost] = Counter()


class Outbox(Generic[M]):
    """All queues of one link. Not thread-safe: it belongs to the event loop."""

    def __init__(self) -> None:
        self._lanes: list[list[tuple[int, int, Queue[M]]]] = [[] for _ in range(LANES)]  # heaps: who waits longest
        self._queues: set[Queue[M]] = set()
        self._numbers = itertools.count()
        self._turns = itertools.count(1)
        self.bytes = 0
        self.messages = 0

    def open(self, queue: Queue[M]) -> Queue[M]:
        """Make a queue part of this outbox."""
        self._queues.add(queue)
        queue.number = next(self._numbers)
        return queue

    def close(self, queue: Queue[M]) -> None:
        """Take a queue out; what waited in it is lost and counted."""
        self._queues.discard(queue)
        self._clear(queue, Lost.UNSENT)

    def clear(self, reason: Lost = Lost.UNSENT) -> None:
        """Lose everything that waits."""
        for queue in self._queues:
            self._clear(queue, reason)

    def full(self, queue: Queue[M], size: int) -> bool:
        """True if one more message of ``size`` bytes would displace another."""
        count = len(queue.waiting)
        if not count:
            return False
        if queue.depth is None:
            return queue.bytes + size > queue.limit_bytes
        limit_bytes = queue.limit_bytes if queue.latched else FRESH_BYTES
        return count >= queue.depth or queue.bytes + size > limit_bytes

    def put(self, queue: Queue[M], message: M) -> None:
        """Let a message wait; the oldest of its topic makes room."""
        waiting = queue.waiting
        size = len(message.payload)
        if waiting:  # the queue keeps its turn, or a busy topic would be sent back at each replacement
            lost = Lost.OVERFLOW if queue.depth is None else Lost.REPLACED
            while waiting and self.full(queue, size):
                self._drop_oldest(queue, lost)
        else:
            heapq.heappush(self._lanes[queue.priority], (queue.turn, queue.number, queue))
        waiting.append(message)
        queue.bytes += size
        self.bytes += size
        self.messages += 1

    def lanes(self) -> Iterator[int]:
        """The priorities that have something waiting, most urgent first."""
        for priority, lane in enumerate(self._lanes):
            if lane:
                yield priority

    def take(self, priority: int, now_ns: int) -> tuple[Queue[M], M] | None:
        """The next message of a lane: the topic that was not served for longest, and of it the oldest."""
        lane = self._lanes[priority]
        while lane:
            queue = lane[0][2]
            waiting = queue.waiting
            message = waiting.popleft()
            size = len(message.payload)
            queue.bytes -= size
            self.bytes -= size
            self.messages -= 1
            queue.turn = next(self._turns)
            if waiting:
                heapq.heapreplace(lane, (queue.turn, queue.number, queue))
            else:
                heapq.heappop(lane)
            if queue.lifespan_ns is not None and now_ns - message.stamp_ns > queue.lifespan_ns:
                queue.lost[Lost.EXPIRED] += 1
                continue
            return queue, message
        return None

    def statistics(self) -> OutboxStatistics:
        """What waits now."""
        return OutboxStatistics(self.messages, self.bytes, sum(1 for q in self._queues if q.waiting))

    def _drop_oldest(self, queue: Queue[M], reason: Lost) -> None:
        old = queue.waiting.popleft()
        size = len(old.payload)
        queue.bytes -= size
        self.bytes -= size
        self.messages -= 1
        queue.lost[reason] += 1

    def _clear(self, queue: Queue[M], reason: Lost) -> None:
        if queue.waiting:
            lane = self._lanes[queue.priority]
            lane.remove((queue.turn, queue.number, queue))
            heapq.heapify(lane)
        while queue.waiting:
            self._drop_oldest(queue, reason)
