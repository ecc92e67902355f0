"""Holds what waits to be sent on one link: priority lanes, and in each the freshest message of every topic.

A topic with ``keep_last`` may have ``depth`` messages waiting, and no more than 64 KiB unless it is a single one: only
the newest frame of a camera waits, but all of a transform tree. The oldest message is displaced, and counted. A topic
with ``keep_all`` waits in a first-in first-out queue that is bounded in bytes.

Which message to send is decided when the link can take it, never before. The topics of a lane share the link by
bytes, not by messages (start-time fair queueing; Goyal, Vin and Cheng, 1996): each has a virtual time, the bytes that
it was served divided by its weight, and the topic with the smallest is next. One that was idle begins where the lane
is, so a topic that needs less than its share gets all it asks for at once, and none saves up.
"""

from __future__ import annotations

import enum
import heapq
import itertools
from collections import Counter, deque
from typing import TYPE_CHECKING, Any, Final, Generic, NamedTuple, Protocol, TypeVar

if TYPE_CHECKING:
    from collections.abc import Iterable, Iterator, Sequence

__all__ = ["LANES", "Lost", "Outbox", "OutboxStatistics", "Queue"]

LANES: Final = 8
FRESH_BYTES: Final = 64 * 1024
KEEP_ALL_LIMIT_BYTES: Final = 16 << 20
SMALL_BYTES: Final = 16 * 1024
"""A message of this size or less may overtake a larger one of its lane that is under way."""


class Lost(enum.Enum):
    """The reasons for which a message was not sent."""

    REPLACED = "a fresher one took its place"
    OVERFLOW = "the queue of the topic was full"
    EXPIRED = "it was older than the lifespan of its topic"
    UNSENT = "the link closed before it could be sent"
    ENCODE = "it could not be encoded"
    REPEATED = "its id had come before"

    __hash__ = object.__hash__  # that of enumerations is written in Python, and drops are looked up for each message


class Message(Protocol):
    """The fields of a message that the outbox reads."""

    @property
    def payload(self) -> bytes:
        """The bytes to send, or those that they are made from; their size counts."""

    @property
    def stamp_ns(self) -> int:
        """Return when it came here."""


M = TypeVar("M", bound=Message)


Lane = list[tuple[float, int, "Queue[M]"]]


class OutboxStatistics(NamedTuple):
    """Counts what waits now."""

    messages: int
    bytes: int
    topics: int


class Queue(Generic[M]):
    """The messages of one topic that wait on one link.

    ``depth`` counts messages, ``None`` means keep all (bounded in bytes); ``lifespan_ns`` is the age at which a
    waiting message is not worth sending; of a ``latched`` topic each of the last ``depth`` messages is wanted,
    whatever their size. ``weight`` is the topic's share of its lane beside those of the others. ``served`` is its
    virtual time, and ``under_way`` is true from ``take`` to ``done``. It is ``held`` from ``adopt`` to ``done``: what
    comes meanwhile is kept beyond the depth, up to 64 KiB. A message of up to ``ready_bytes`` is sent as it is.
    """

    __slots__ = (
        "bytes",
        "depth",
        "held",
        "key",
        "lane",
        "latched",
        "lifespan_ns",
        "limit_bytes",
        "lost",
        "number",
        "priority",
        "ready_bytes",
        "served",
        "under_way",
        "waiting",
        "weight",
    )

    def __init__(
        self,
        key: Any,
        *,
        priority: int = 4,
        depth: int | None = 1,
        lifespan_ns: int | None = None,
        limit_bytes: int = KEEP_ALL_LIMIT_BYTES,
        weight: float = 1.0,
    ) -> None:
        self.key = key
        self.priority = min(max(priority, 0), LANES - 1)
        self.depth = None if depth is None else max(depth, 1)
        self.lifespan_ns = lifespan_ns
        self.limit_bytes = limit_bytes
        self.latched = False
        self.waiting: deque[M] = deque()
        self.bytes = 0
        self.ready_bytes = -1
        self.number = 0
        self.lane: Lane[M] = []  # where it waits
        self.weight = weight
        self.served = 0.0
        self.under_way = False
        self.held = False
        self.lost: Counter[Lost] = Counter()


class Outbox(Generic[M]):
    """Holds all queues of one link. Not thread-safe: it belongs to the event loop."""

    def __init__(self) -> None:
        self._small: list[Lane[M]] = [[] for _ in range(LANES)]  # heaps by virtual time, of topics whose next
        self._big: list[Lane[M]] = [[] for _ in range(LANES)]  # message is small, and of the others
        self._under_way: list[list[Queue[M]]] = [[] for _ in range(LANES)]
        self._times = [0.0] * LANES  # the virtual time at which each lane became empty
        self._queues: set[Queue[M]] = set()
        self._numbers = itertools.count()
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

    def release(self, queue: Queue[M]) -> list[M]:
        """Take a queue out; return what waited in it. Its message must not be under way."""
        self._queues.discard(queue)
        if queue.waiting:
            self._line_out(queue)
        waiting = list(queue.waiting)
        queue.waiting.clear()
        self.messages -= len(waiting)
        self.bytes -= queue.bytes
        queue.bytes = 0
        queue.served = 0.0  # each outbox has a time of its own
        return waiting

    def adopt(self, queue: Queue[M], waiting: Iterable[M]) -> None:
        """Take a queue over, and what waited in it; nothing of it is sent before ``done`` is called for it."""
        self.open(queue)
        queue.served = self._time(queue.priority)
        queue.under_way = queue.held = True
        self._under_way[queue.priority].append(queue)
        for message in waiting:
            self.put(queue, message)

    def put_back(self, queue: Queue[M], messages: Sequence[M]) -> None:
        """Let messages go before those that wait in a queue that is held; of too many the last."""
        for message in reversed(messages):
            size = len(message.payload)
            if self.full(queue, size):
                return
            queue.waiting.appendleft(message)
            queue.bytes += size
            self.bytes += size
            self.messages += 1

    def clear(self, reason: Lost = Lost.UNSENT) -> None:
        """Drop everything that waits, and count it as lost."""
        for queue in self._queues:
            self._clear(queue, reason)

    def full(self, queue: Queue[M], size: int) -> bool:
        """Return whether one more message of ``size`` bytes would displace another."""
        count = len(queue.waiting)
        if not count:
            return False
        if queue.depth is None:
            return queue.bytes + size > queue.limit_bytes
        if queue.held:
            return queue.bytes + size > FRESH_BYTES
        limit_bytes = queue.limit_bytes if queue.latched else FRESH_BYTES
        return count >= queue.depth or queue.bytes + size > limit_bytes

    def put(self, queue: Queue[M], message: M) -> None:
        """Let a message wait; the oldest of its topic makes room."""
        waiting = queue.waiting
        size = len(message.payload)
        first = not waiting
        if not first:  # the queue keeps its turn, or a busy topic would be sent back at each replacement
            lost = Lost.OVERFLOW if queue.depth is None else Lost.REPLACED
            while waiting and self.full(queue, size):
                self._drop_oldest(queue, lost)
        waiting.append(message)
        queue.bytes += size
        self.bytes += size
        self.messages += 1
        if first and not queue.under_way:
            priority = queue.priority
            lane = queue.lane = (self._small if size <= SMALL_BYTES else self._big)[priority]
            idle = not (self._small[priority] or self._big[priority] or self._under_way[priority])
            time = self._times[priority] if idle else self._time(priority)
            if queue.served < time:  # it was idle, and has saved nothing up
                queue.served = time
            heapq.heappush(lane, (queue.served, queue.number, queue))

    def lanes(self) -> Iterator[int]:
        """Yield the priorities that have something waiting, most urgent first."""
        for priority, (small, big) in enumerate(zip(self._small, self._big, strict=True)):
            if small or big:
                yield priority

    def waits(self, priority: int) -> bool:
        """Return whether something waits in a lane."""
        return bool(self._small[priority] or self._big[priority])

    def first(self, priority: int) -> tuple[Queue[M], M] | None:
        """Return what ``take`` would take of a lane, and leave it there."""
        heads = [heap[0] for heap in (self._small[priority], self._big[priority]) if heap]
        if not heads:
            return None
        queue = min(heads)[2]
        return queue, queue.waiting[0]

    def overtakes(self, priority: int, queue: Queue[M]) -> bool:
        """Return whether a small message that waits in a lane goes before the big one of ``queue`` is sent whole.

        It does if its topic was served less: the big one is hardly later for it.
        """
        small = self._small[priority]
        return bool(small) and small[0][0] <= queue.served

    def take(self, priority: int, now_ns: int, *, small: bool = False) -> tuple[Queue[M], M] | None:
        """Take the next message of a lane: of the topic that was served least, the oldest.

        Tell ``served`` what is sent of it and ``done`` when it has gone; its topic has no other turn before. With
        ``small`` only topics with a small message have a turn.
        """
        lane, big = self._small[priority], self._big[priority]
        while lane or (big and not small):
            heap = lane if not big or small or (lane and lane[0] < big[0]) else big
            _, _, queue = heapq.heappop(heap)
            message = queue.waiting.popleft()
            size = len(message.payload)
            queue.bytes -= size
            self.bytes -= size
            self.messages -= 1
            if queue.lifespan_ns is not None and now_ns - message.stamp_ns > queue.lifespan_ns:
                queue.lost[Lost.EXPIRED] += 1
                self.done(queue)
                continue
            queue.under_way = True
            self._under_way[priority].append(queue)
            return queue, message
        return None

    def take_next(self, queue: Queue[M], now_ns: int) -> M | None:
        """Take what follows of a topic that is under way, if it is small and ``done`` and ``take`` would give it next.

        ``None`` where another topic is next, or there is nothing to take.
        """
        if not queue.waiting or queue.held:
            return None
        message, turn = queue.waiting[0], (queue.served, queue.number)
        size = len(message.payload)
        if size > SMALL_BYTES or (queue.lifespan_ns is not None and now_ns - message.stamp_ns > queue.lifespan_ns):
            return None
        priority = queue.priority
        for heap in (self._small[priority], self._big[priority]):
            if heap and heap[0][:2] < turn:
                return None
        queue.waiting.popleft()
        queue.bytes -= size
        self.bytes -= size
        self.messages -= 1
        if self._times[priority] < queue.served:
            self._times[priority] = queue.served
        return message

    def take_ready(self, room_bytes: int, header_bytes: int, now_ns: int) -> tuple[Queue[M], M] | None:
        """Take the next message of the most urgent lane, if it is small and ready and there is room for it.

        Its topic is charged for it and ``header_bytes``, and has its next turn at once: there is no ``served`` and
        ``done`` to tell.
        """
        for priority, lane in enumerate(self._small):
            big = self._big[priority]
            if not lane and not big:
                continue
            if not lane or (big and big[0] < lane[0]):
                return None
            queue = lane[0][2]
            message = queue.waiting[0]
            size = len(message.payload)
            if size > queue.ready_bytes or size > room_bytes:
                return None
            if queue.lifespan_ns is not None and now_ns - message.stamp_ns > queue.lifespan_ns:
                return None  # ``take`` counts it
            heapq.heappop(lane)
            queue.waiting.popleft()
            queue.bytes -= size
            self.bytes -= size
            self.messages -= 1
            queue.served += (size + header_bytes) / queue.weight
            if self._times[priority] < queue.served:
                self._times[priority] = queue.served
            if queue.waiting:
                self._line_up(queue)
            return queue, message
        return None

    def passed(self, queue: Queue[M], size_bytes: int) -> None:
        """Charge a topic for what was sent of it at once: nothing waited or was under way, so it was its turn."""
        times, priority = self._times, queue.priority
        queue.served = times[priority] = max(queue.served, times[priority]) + size_bytes / queue.weight

    def served(self, queue: Queue[M], size_bytes: int) -> None:
        """Charge a topic for the bytes that were sent of its message."""
        queue.served += size_bytes / queue.weight

    def done(self, queue: Queue[M]) -> None:
        """Let a topic have its next turn: its message has gone."""
        if queue.under_way:
            queue.under_way = queue.held = False
            self._under_way[queue.priority].remove(queue)
            self._times[queue.priority] = max(self._times[queue.priority], queue.served)
        if queue.waiting and queue in self._queues:
            self._line_up(queue)

    def _time(self, priority: int) -> float:
        """Return the virtual time of a lane: that of the least-served topic among those that have something to send."""
        times = [heap[0][0] for heap in (self._small[priority], self._big[priority]) if heap]
        times += [queue.served for queue in self._under_way[priority]]
        return min(times) if times else self._times[priority]

    def _line_up(self, queue: Queue[M]) -> None:
        size = len(queue.waiting[0].payload)
        queue.lane = (self._small if size <= SMALL_BYTES else self._big)[queue.priority]
        heapq.heappush(queue.lane, (queue.served, queue.number, queue))

    @staticmethod
    def _line_out(queue: Queue[M]) -> None:
        queue.lane.remove((queue.served, queue.number, queue))
        heapq.heapify(queue.lane)

    def statistics(self) -> OutboxStatistics:
        """Return how much waits now."""
        return OutboxStatistics(self.messages, self.bytes, sum(1 for q in self._queues if q.waiting))

    def _drop_oldest(self, queue: Queue[M], reason: Lost) -> None:
        old = queue.waiting.popleft()
        size = len(old.payload)
        queue.bytes -= size
        self.bytes -= size
        self.messages -= 1
        queue.lost[reason] += 1

    def _clear(self, queue: Queue[M], reason: Lost) -> None:
        if queue.waiting and not queue.under_way:
            self._line_out(queue)
        while queue.waiting:
            self._drop_oldest(queue, reason)
