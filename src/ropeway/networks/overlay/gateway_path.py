"""The path to one gateway that acknowledges what it gets: how much may be on the way to it, without input or output.

What is handed to Zenoh waits in queues of its own, in the kernel's and in those of the routers between, and what waits
there is stale. So each packet has a number, the far gateway tells the newest number that came, and a model of links
tells from that how much may be under way.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Iterable
from typing import Final

from ropeway.delivery.outbox import LANES
from ropeway.delivery.pacing.model import LinkModel, LinkReading
from ropeway.delivery.pacing.pace import Pace

__all__ = ["Path"]

_SEGMENT_BYTES: Final = 1448  # what a packet on the way usually carries
_STALLED_S: Final = 1.0  # without an acknowledgement: the others are not held up any more
_STALLED_ROUND_TRIPS: Final = 4
_FAST_BPS: Final = 10e6
_FAST_S: Final = 0.02  # so much may wait on a fast and near path
_FAST_PART_S: Final = 0.01
_FAST_ROUND_TRIP_S: Final = 0.005
_PART_S: Final = 0.002  # a part takes about so long, so that an urgent message waits no longer
_PART_MIN_BYTES: Final = 4 * 1024
_PART_MAX_BYTES: Final = 1 << 20
_NO_LIMIT: Final = 1 << 40
_SAMPLES: Final = 8
"""Of so many round trips the shortest counts: what waits behind a packet that was lost comes late on any link."""
_LEAST_ROW_S: Final = 0.01  # what waited behind a packet that was lost comes all at once
_SHORTEST_ROW_S: Final = 0.03
_DOWN: Final = 0.05  # a row that such a packet held up says little of the link
_MOST_BLOCKED: Final = 0.75
_RTT_WEIGHT: Final = 1 / 8  # as TCP smooths it (RFC 6298)
_DEVIATION_WEIGHT: Final = 1 / 4


class Path:
    """What is under way to one gateway.

    ``sent`` may be called from one thread per lane; all else belongs to the event loop. ``stalled`` is true while
    nothing is acknowledged: such a path holds nobody up.
    """

    def __init__(self) -> None:
        pace = Pace(least_row_s=_LEAST_ROW_S, shortest_row_s=_SHORTEST_ROW_S, down=_DOWN)
        self.model = LinkModel(pace, part_bytes=_PART_MIN_BYTES)
        self.stalled = False
        self._under_way: list[deque[tuple[int, int, float]]] = [deque() for _ in range(LANES)]  # number, bytes, when
        self._sent_bytes = [0] * LANES  # each changed by its lane's thread alone
        self._delivered_bytes = 0
        self._pending_bytes = 0
        self._rtt_s = self._deviation_s = 0.0
        self._samples: deque[float] = deque(maxlen=_SAMPLES)
        self._heard_s = float("-inf")

    # ── what goes out ──────────────────────────────────────────────────────────────────────────────────────────

    def hand(self, size_bytes: int) -> None:
        """Note what is on its way to a lane's thread."""
        self._pending_bytes += size_bytes
        self.model.handed(size_bytes)

    def landed(self, size_bytes: int) -> None:
        """Note that the thread has sent it, or failed to."""
        self._pending_bytes -= size_bytes

    def sent(self, lane: int, number: int, size_bytes: int, now_s: float) -> None:
        """Note a packet just before it is put; in the lane's thread."""
        self._under_way[lane].append((number, size_bytes, now_s))
        self._sent_bytes[lane] += size_bytes

    def room_bytes(self, now_s: float) -> int:
        """Return how much more may be sent now."""
        if self.stalled:
            return _NO_LIMIT
        if self._is_stalled(now_s):
            self._forget()
            self.stalled = True
            return _NO_LIMIT
        model = self.model
        if model.room_bytes <= 0:
            model.observe(self._reading(now_s))
        fast = self._fast_bps
        return model.room_bytes if fast is None else max(model.room_bytes, int(_FAST_S * fast) - self.in_flight_bytes)

    @property
    def _fast_bps(self) -> float | None:
        """The pace of a near and fast path, where processors are what takes time; ``None`` for any other."""
        pace, base_s = self.model.pace.bytes_per_s, self.model.base_rtt_s
        near = base_s is not None and base_s < _FAST_ROUND_TRIP_S
        return pace if near and pace is not None and pace > _FAST_BPS else None

    @property
    def in_flight_bytes(self) -> int:
        """Return what was handed over and is not acknowledged."""
        return max(sum(self._sent_bytes) - self._delivered_bytes, 0) + self._pending_bytes

    @property
    def part_bytes(self) -> int:
        """Return the size of a part: what the path carries in a moment."""
        pace = self.model.pace.bytes_per_s
        part_s = _PART_S if self._fast_bps is None else _FAST_PART_S
        wanted = self.model.window_bytes / 4 if pace is None else pace * part_s
        return int(min(max(wanted, _PART_MIN_BYTES), _PART_MAX_BYTES))

    # ── what arrived ───────────────────────────────────────────────────────────────────────────────────────────

    def acknowledged(self, newest: Iterable[tuple[int, int]], now_s: float) -> None:
        """Learn which packet of each lane is the newest that came, as ``(lane, number)``.

        Numbers that were not sent count for as much as was.
        """
        latest_s, moved = float("-inf"), False
        for lane, number in newest:
            if not 0 <= lane < LANES:
                continue
            under_way = self._under_way[lane]
            while under_way and under_way[0][0] <= number:
                _, size, at_s = under_way.popleft()
                self._delivered_bytes += size
                latest_s, moved = max(latest_s, at_s), True
        if moved:
            self.stalled, self._heard_s = False, now_s
            self._sample(max(now_s - latest_s, 1e-6))
            self.model.observe(self._reading(now_s))

    def _sample(self, rtt_s: float) -> None:
        self._samples.append(rtt_s)
        if not self._rtt_s:
            self._rtt_s, self._deviation_s = rtt_s, rtt_s / 2
            return
        self._deviation_s += _DEVIATION_WEIGHT * (abs(rtt_s - self._rtt_s) - self._deviation_s)
        self._rtt_s += _RTT_WEIGHT * (rtt_s - self._rtt_s)

    def _reading(self, now_s: float) -> LinkReading:
        shortest_s = min(self._samples, default=0.0)
        in_flight, pace = self.in_flight_bytes, self.model.pace.bytes_per_s
        if pace is not None:  # what is there already, behind a packet that was lost, is not on the way
            in_flight -= int(min(pace * max(self._rtt_s - shortest_s, 0.0), _MOST_BLOCKED * in_flight))
        return LinkReading(
            now_s,
            self._delivered_bytes,
            in_flight,
            0,
            shortest_s,
            self._deviation_s,
            0,
            _SEGMENT_BYTES,
        )

    def _is_stalled(self, now_s: float) -> bool:
        oldest_s = min((under_way[0][2] for under_way in self._under_way if under_way), default=now_s)
        return now_s - max(oldest_s, self._heard_s) > max(_STALLED_S, _STALLED_ROUND_TRIPS * self._rtt_s)

    def _forget(self) -> None:
        """Count on no acknowledgement of what is under way."""
        for under_way in self._under_way:
            while under_way:
                self._delivered_bytes += under_way.popleft()[1]
