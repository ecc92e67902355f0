"""Sends what publishers have: the freshest of every topic, decided when its path has room and not before.

Where the gateways that read a topic acknowledge what came, no more is handed to Zenoh than is useful on the way, and
big messages go in parts that small ones overtake. Where one does not, messages go whole, and Zenoh's queues decide.
"""

from __future__ import annotations

import asyncio
import logging
import time
from collections import deque
from collections.abc import Callable, Sequence
from functools import partial
from typing import Final, cast

from ropeway import aio
from ropeway.delivery.outbox import LANES, Outbox, Queue
from ropeway.errors import GraphUnavailable
from ropeway.graph.base import Sample, Undelivered
from ropeway.limits import OVERLAY_COPY_BYTES
from ropeway.networks.overlay.gateway_path import Path
from ropeway.networks.overlay.graph.host import OverlayHost
from ropeway.networks.overlay.graph.publisher import OverlayPublisher
from ropeway.networks.overlay.packet_item import PacketItem
from ropeway.networks.overlay.packet_mark import Mark

__all__ = ["OverlaySender"]

log = logging.getLogger("ropeway.overlay")

_BATCH_BYTES: Final = 256 * 1024  # which makes a signature and its check cheap, where the path carries it in no time
_PLAIN_BATCH_BYTES: Final = 64 * 1024  # where nothing is known of the path
_BATCH: Final = 256
_AHEAD_BYTES: Final = 128 * 1024  # of small messages the next batch is made ready while one is sealed
_ITEM_BYTES: Final = 64  # what a message costs beside its payload
_PACKET_BYTES: Final = 200  # and what a packet costs
_AHEAD_S: Final = 0.01  # before the end of a message the next is sealed, so that the path does not wait for it
_FLUSH_S: Final = 2.0
_LOOK_S: Final = 0.004  # at paths that have no room: what is late, or stalled, makes some
_OVERDRAFT_BYTES: Final = 4 * 1024  # of small messages, while there is no room
_NO_LIMIT: Final = 1 << 40

Job = tuple[OverlayPublisher, list[tuple[PacketItem, bool]]]
Lot = frozenset[bytes]
"""The gateways that a message goes to."""


class _Cursor:
    """A message that goes in parts; ``packet`` is ``None`` while a thread seals it."""

    __slots__ = ("at", "number", "packet", "publisher")

    def __init__(self, publisher: OverlayPublisher, number: int) -> None:
        self.publisher, self.number = publisher, number
        self.packet: bytes | None = None
        self.at = 0


class _Group:
    """The publishers that the same gateways read; with ``copies`` all of these tell copies from replays."""

    def __init__(self, lot: Lot, *, copies: bool) -> None:
        self.lot, self.copies = lot, copies
        self.outbox: Outbox[Sample] = Outbox()
        self.queues: set[Queue[Sample]] = set()
        self.cursors: list[deque[_Cursor]] = [deque() for _ in range(LANES)]  # the first is being sent
        self.overdrawn_bytes = 0

    @property
    def idle(self) -> bool:
        """Whether it is empty."""
        return not self.queues and not any(self.cursors)


class OverlaySender:
    """Takes from the outboxes what may go now, and hands it to the threads of the lanes."""

    def __init__(self, graph: OverlayHost) -> None:
        self._graph = graph
        self._receipts = graph.node.receipts
        self._groups: dict[Lot, _Group] = {}
        self._group_of: dict[Queue[Sample], _Group] = {}
        self._aims: dict[Queue[Sample], Lot] = {}  # of those that are to move once their message has gone
        self._pending = [0] * LANES  # bytes on their way through the lanes' threads
        self._sealing: set[asyncio.Future[bytes]] = set()
        self._loop = asyncio.get_running_loop()
        self._scheduled = self._pumping = self._closed = False
        self._look: asyncio.TimerHandle | None = None
        self._idle = asyncio.Event()
        self._end = self._receipts.on_change(self.pump)

    # ── publishers ─────────────────────────────────────────────────────────────────────────────────────────────

    def open(self, queue: Queue[Sample]) -> None:
        """Let a publisher use it."""
        self._join(queue, frozenset())

    def drop(self, queue: Queue[Sample]) -> None:
        """Drop what waits for a publisher that has left."""
        self._aims.pop(queue, None)
        group = self._group_of.pop(queue, None)
        if group is not None:
            group.outbox.close(queue)
            self._leave(queue, group)

    def aim(self, queue: Queue[Sample], gateways: Lot) -> None:
        """Send a publisher's messages to these gateways."""
        group = self._group_of.get(queue)
        if group is None:
            return
        self._aims.pop(queue, None)
        if queue.under_way:
            self._aims[queue] = gateways
        elif gateways != group.lot:
            waiting = group.outbox.release(queue)
            self._leave(queue, group)
            group = self._join(queue, gateways)
            for sample in waiting:
                group.outbox.put(queue, sample)
            self._wake()

    def _join(self, queue: Queue[Sample], lot: Lot) -> _Group:
        group = self._groups.get(lot)
        if group is None:
            group = self._groups[lot] = _Group(lot, copies=all(map(self._graph.node.membership.ways, lot)))
        group.queues.add(queue)
        group.outbox.open(queue)
        self._group_of[queue] = group
        return group

    def _leave(self, queue: Queue[Sample], group: _Group) -> None:
        group.queues.discard(queue)
        if group.idle:
            self._groups.pop(group.lot, None)

    def put(self, queue: Queue[Sample], sample: Sample) -> None:
        """Let a message wait for its turn; what is full is sent first, if the path takes it."""
        outbox = self._group_of[queue].outbox
        if outbox.full(queue, len(sample.payload)):
            self.pump()
        outbox.put(queue, sample)
        self._wake()

    def slowest(self, queue: Queue[Sample]) -> float | None:
        """Return the pace of the slowest path of a publisher, ``None`` where none acknowledges."""
        group = self._group_of.get(queue)
        paces = [] if group is None else [path.model.pace.bytes_per_s for path in self._paths(group)]
        return min((pace for pace in paces if pace is not None), default=None)

    async def flush(self, queue: Queue[Sample]) -> None:
        """Wait until a publisher has nothing waiting, for a little while."""
        try:
            async with aio.timeout(_FLUSH_S):
                while queue.waiting or queue.under_way or self._pending[queue.priority]:
                    self._idle.clear()
                    await self._idle.wait()
        except TimeoutError:
            log.debug("overlay: %s has left with %d messages unsent", self._graph.name, len(queue.waiting))

    async def close(self) -> None:
        """Send nothing more."""
        self._closed = True
        self._end()
        if self._look is not None:
            self._look.cancel()
        for sealing in self._sealing:
            sealing.cancel()
        for group in self._groups.values():
            group.outbox.clear()

    # ── paths ──────────────────────────────────────────────────────────────────────────────────────────────────

    def _paths(self, group: _Group) -> list[Path]:
        paths = self._receipts.paths
        return [paths[gateway] for gateway in group.lot if gateway in paths]

    def _room_bytes(self, group: _Group) -> int:
        """Return what the slowest path has room for; one that acknowledges nothing holds nobody up."""
        now_s = time.monotonic()
        return min((path.room_bytes(now_s) for path in self._paths(group)), default=_NO_LIMIT)

    def _part_bytes(self, group: _Group) -> int:
        """Return how large a packet may be that goes whole."""
        paths = self._paths(group)
        if not paths or len(paths) < len(group.lot):
            return _NO_LIMIT  # somebody could not put the parts together
        return min(path.part_bytes for path in paths)

    # ── turns ──────────────────────────────────────────────────────────────────────────────────────────────────

    def _wake(self) -> None:
        if not self._scheduled:
            self._scheduled = True
            self._loop.call_soon(self._scheduled_pump)

    def _scheduled_pump(self) -> None:
        self._scheduled = False
        self.pump()

    def _look_again(self) -> None:
        self._look = None
        self.pump()

    def pump(self) -> None:
        """Hand over what may go now, the most urgent lane first. A call from inside goes on where it is."""
        if self._pumping or self._closed:
            return
        self._pumping = True
        try:
            for lane in range(LANES):
                while self._pending[lane] < _AHEAD_BYTES and self._turn(lane):
                    pass
        finally:
            self._pumping = False
        waits = any(group.outbox.messages or any(group.cursors) for group in self._groups.values())
        if waits and self._look is None:
            self._look = self._loop.call_later(_LOOK_S, self._look_again)

    def _turn(self, lane: int) -> bool:
        """Let the next group that can send something in a lane do so; return whether there was one."""
        for lot, group in list(self._groups.items()):
            waits = group.cursors[lane] or group.outbox.waits(lane)
            if waits and self._send_within(self._room_bytes(group), lane, group):
                if len(self._groups) > 1 and self._groups.get(lot) is group:  # to the end: the others are next
                    self._groups[lot] = self._groups.pop(lot)
                return True
        return False

    def _send_within(self, room_bytes: int, lane: int, group: _Group) -> bool:
        """Send the next; small messages need not wait until the path has room, as they hardly take any."""
        if room_bytes > 0:
            group.overdrawn_bytes = 0
            return self._send_next(lane, group)
        if group.overdrawn_bytes >= _OVERDRAFT_BYTES:
            return False
        before = self._pending[lane]
        sent = self._send_whole(lane, group, small=True)
        group.overdrawn_bytes += self._pending[lane] - before
        return sent

    def _send_next(self, lane: int, group: _Group) -> bool:
        cursors = group.cursors[lane]
        overtaken = not cursors or group.outbox.overtakes(lane, cursors[0].publisher.queue)
        if overtaken and self._send_whole(lane, group, small=bool(cursors)):
            return True
        if not cursors or cursors[0].packet is None:
            return False
        self._send_part(lane, group, cursors[0], cursors[0].packet)
        return True

    def _send_whole(self, lane: int, group: _Group, *, small: bool) -> bool:
        jobs, size = self._gather(lane, group, small=small)
        if jobs:
            ways = self._bypasses(group, jobs)
            self._hand(lane, group, partial(self._send, lane, group, jobs, self._paths(group), ways), size, jobs)
        return bool(jobs)

    def _bypasses(self, group: _Group, jobs: Sequence[Job]) -> list[list[bytes] | None]:
        """Return, for each publisher, the gateways that have a copy of its packet by the bypass; ``None`` for one that
        is none of the bypass's.
        """
        paths, now_s = self._receipts.paths, time.monotonic()
        far = [(gateway, paths[gateway]) for gateway in group.lot if gateway in paths and paths[gateway].far]
        if not far:
            return [None] * len(jobs)
        ways: list[list[bytes] | None] = []
        for publisher, items in jobs:
            size = sum(len(item.payload) + _ITEM_BYTES for item, _ in items) + _PACKET_BYTES
            if size > OVERLAY_COPY_BYTES:
                ways.append(None)
                continue
            endpoint = publisher.advert.endpoint
            ways.append([gateway for gateway, path in far if path.copies(endpoint, size, now_s)])
        if any(ways):
            self._graph.node.bypass.want()
        return ways

    def _gather(self, lane: int, group: _Group, *, small: bool) -> tuple[list[Job], int]:
        """Take what goes whole in one turn, by publisher; what goes in parts is begun."""
        found: dict[OverlayPublisher, list[tuple[PacketItem, bool]]] = {}
        outbox, limit, now_ns = group.outbox, self._part_bytes(group), time.time_ns()
        most = _PLAIN_BATCH_BYTES if limit == _NO_LIMIT else min(_BATCH_BYTES, limit)
        size = count = 0
        taken = None
        while size < most and count < _BATCH:
            taken = taken or outbox.take(lane, now_ns, small=small)
            if taken is None:
                break
            queue, sample = taken
            publisher, length, piece = self._piece(queue, sample)
            if length + _PACKET_BYTES > limit and not small:
                self._begin(lane, group, publisher, piece)
                break
            found.setdefault(publisher, []).append(piece)
            outbox.served(queue, length)
            size += length
            count += 1
            following = outbox.take_next(queue, now_ns) if size < most and count < _BATCH else None
            taken = None if following is None else (queue, following)
            if taken is None:
                self._done(group, queue)
        return list(found.items()), size + _PACKET_BYTES * len(found)

    @staticmethod
    def _piece(queue: Queue[Sample], sample: Sample) -> tuple[OverlayPublisher, int, tuple[PacketItem, bool]]:
        """Return whose message it is, its length, and the message as it is to be sent."""
        publisher = cast("OverlayPublisher", queue.key)
        length = len(sample.payload) + _ITEM_BYTES
        return publisher, length, (publisher.add(sample), publisher.packing.choose(length, queue.lost))

    def _done(self, group: _Group, queue: Queue[Sample]) -> None:
        group.outbox.done(queue)
        aim = self._aims.pop(queue, None)
        if aim is not None:
            self.aim(queue, aim)

    # ── whole packets ──────────────────────────────────────────────────────────────────────────────────────────

    def _hand(self, lane: int, group: _Group, work: Callable[[], None], size: int, jobs: Sequence[Job]) -> None:
        """Hand work to the lane's thread that sends about this many bytes."""
        paths = self._paths(group)
        self._pending[lane] += size
        for path in paths:
            path.hand(size)
        future = self._graph.node.fabric.in_lane(lane, work)
        future.add_done_callback(partial(self._handed, lane, paths, size, jobs))

    def _handed(
        self, lane: int, paths: Sequence[Path], size: int, jobs: Sequence[Job], future: asyncio.Future[None]
    ) -> None:
        self._pending[lane] -= size
        for path in paths:
            path.landed(size)
        if not future.cancelled() and (error := future.exception()) is not None:
            self._lost(jobs, error)
        for publisher, items in jobs:
            publisher.source.sent(items[-1][0].number)
        self._idle.set()
        self.pump()

    def _lost(self, jobs: Sequence[Job], error: BaseException) -> None:
        """Count what could not be sent: sealing and sending are libraries' work, and must not end the lane."""
        closed = isinstance(error, GraphUnavailable)
        if not closed:
            log.error("overlay: %s cannot send", self._graph.name, exc_info=error)
        for publisher, items in jobs:
            self._graph.drops[publisher.topic, Undelivered.CLOSED if closed else Undelivered.WRITE] += len(items)

    def _send(
        self,
        lane: int,
        group: _Group,
        jobs: Sequence[Job],
        paths: Sequence[Path],
        ways: Sequence[Sequence[bytes] | None],
    ) -> None:
        """Seal and put a batch; runs in the lane's thread."""
        connection = self._graph.node.bypass.connection
        for (publisher, items), gateways in zip(jobs, ways, strict=True):
            packet = publisher.source.seal([publisher.packing.pack(item, on) for item, on in items])
            if gateways is not None:
                publisher.copies.send(packet, gateways, connection, time.monotonic())
            began = time.perf_counter()
            self._put(lane, group, publisher, packet, paths)
            publisher.packing.taken(len(packet), time.perf_counter() - began)

    def _put(
        self,
        lane: int,
        group: _Group,
        publisher: OverlayPublisher,
        raw: bytes,
        paths: Sequence[Path],
        at: int = 0,
        size: int = 0,
    ) -> None:
        """Put one packet; runs in the lane's thread."""
        number = self._receipts.next_number(lane)
        now_s = time.monotonic()
        for path in paths:
            path.sent(lane, number, len(raw), now_s)
        mark = Mark(lane, number, at, size).to_bytes()
        self._graph.node.fabric.put(lane, publisher.wire_key(), raw, mark, copies=group.copies)

    # ── parts ──────────────────────────────────────────────────────────────────────────────────────────────────

    def _begin(self, lane: int, group: _Group, publisher: OverlayPublisher, piece: tuple[PacketItem, bool]) -> None:
        """Begin to seal a message that goes in parts."""
        cursor = _Cursor(publisher, piece[0].number)
        group.cursors[lane].append(cursor)

        def seal() -> bytes:
            return publisher.source.seal([publisher.packing.pack(*piece)])

        def sealed(future: asyncio.Future[bytes]) -> None:
            self._sealing.discard(future)
            if future.cancelled():
                return
            error = future.exception()
            if error is None:
                cursor.packet = future.result()
            else:
                self._lost([(publisher, [piece])], error)
                self._finish(lane, group, cursor)
            self.pump()

        future = self._loop.run_in_executor(None, seal)
        self._sealing.add(future)
        future.add_done_callback(sealed)

    def _send_part(self, lane: int, group: _Group, cursor: _Cursor, packet: bytes) -> None:
        publisher, at, size = cursor.publisher, cursor.at, len(packet)
        now_s = time.monotonic()
        for path in self._paths(group):
            path.laden(now_s)
        raw = packet[at : at + min(self._part_bytes(group), size)]
        whole = len(raw) == size
        work = partial(self._put, lane, group, publisher, raw, self._paths(group), at, 0 if whole else size)
        self._hand(lane, group, work, len(raw), ())
        cursor.at += len(raw)
        group.outbox.served(publisher.queue, len(raw))
        if cursor.at >= size:
            self._finish(lane, group, cursor)
        elif len(group.cursors[lane]) == 1:
            self._begin_next(lane, group, size - cursor.at)

    def _begin_next(self, lane: int, group: _Group, left_bytes: int) -> None:
        """Begin to seal the next message that goes in parts, once little is left of this one: the path is
        not to wait.
        """
        paces = [path.model.pace.bytes_per_s or 0.0 for path in self._paths(group)]
        if left_bytes > _AHEAD_S * min(paces, default=0.0):
            return
        first = group.outbox.first(lane)
        if first is None or len(first[1].payload) + _ITEM_BYTES + _PACKET_BYTES <= self._part_bytes(group):
            return
        taken = group.outbox.take(lane, time.time_ns())
        if taken is not None:
            publisher, _, piece = self._piece(*taken)
            self._begin(lane, group, publisher, piece)

    def _finish(self, lane: int, group: _Group, cursor: _Cursor) -> None:
        group.cursors[lane].remove(cursor)
        cursor.publisher.source.sent(cursor.number)
        self._done(group, cursor.publisher.queue)
        if group.idle:
            self._groups.pop(group.lot, None)
