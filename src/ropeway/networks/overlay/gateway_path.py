"""Decides how much may be in flight to one gateway that acknowledges what it gets. Sans-I/O.

Data handed to Zenoh waits in Zenoh's queues, the kernel's and those of the routers between, where it goes stale. So
each packet has a number, the far gateway acknowledges the newest number that it received, and a model of the link
derives from that how much may be in flight.

Packets come in order. One that the link loses holds up all that were sent after it, for a round trip and more, and
then they come all at once. Neither is a sign of a full link, so what is measured has to bear it:

* of the last few round trips the **shortest** counts: the queue is what even that one waited;
* a packet that is **late**, more so than that, has most likely left the link and waits for one before it. It is not
  counted as under way, up to one and a half windows of such packets;
* the **pace** is what arrived in a round trip over the time in which it was sent, or that in which it came, whichever
  was longer: what comes all at once was sent more slowly (the delivery rate of Cheng, Cardwell, Hassas Yeganeh and
  Jacobson).

What receipts that come all at once make room for is spread over time, so that commands wait behind little of it.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Iterable
from typing import Final, NamedTuple

from ropeway.delivery.outbox import LANES
from ropeway.delivery.pacing.model import LinkModel, LinkTraits
from ropeway.delivery.pacing.pace import Pace
from ropeway.delivery.pacing.rounds import LinkReading
from ropeway.networks.overlay.copies import CopyBudget
from ropeway.networks.overlay.shortest_round_trip import ShortestRoundTrip

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
_SAMPLED_ROUND_TRIPS: Final = 3  # of those of so many the shortest counts
_LADEN_S: Final = 1.0  # after a big message small ones have copies for so long
_SPREAD_GAIN: Final = 1.25  # times the pace, so that a path that became faster shows
_SPREAD_S: Final = 0.005  # so much goes at once
_SPREAD_PARTS: Final = 2  # and at least so many parts
_LATE_S: Final = 0.004  # what comes so long after it should was held up by a packet that was lost
_MOST_LATE_WINDOWS: Final = 1.5  # more are late where the path has become slower
_LATE_PARTS: Final = 2  # on a slow path, the time that so many parts take
_TELLING_BYTES: Final = 8 * _SEGMENT_BYTES  # fewer, in less time, say nothing of the pace
_TELLING_S: Final = 0.05
_UP: Final = 0.25  # of the difference, per round trip
_DOWN: Final = 0.125
_TRAITS: Final = LinkTraits(
    part_bytes=_PART_MIN_BYTES,
    slack_s=0.002,  # receipts are bundled for so long
    echo_rounds=_SAMPLED_ROUND_TRIPS,
    most_windows=1.5,  # losses hide a queue, so the window is bounded by the pace as well
)
_RTT_WEIGHT: Final = 1 / 8  # as TCP smooths it (RFC 6298)
_DEVIATION_WEIGHT: Final = 1 / 4


class _Packet(NamedTuple):
    """A packet under way, and what had come when it was sent: how much, when, and when the last of that was sent.

    It was ``held`` if there was more to send than the path had room for.
    """

    number: int
    size_bytes: int
    sent_s: float
    delivered_bytes: int
    came_s: float
    before_s: float
    held: bool


class _PathPace(Pace):
    """The pace of a path, which measures it round trip by round trip."""

    def __init__(self) -> None:
        super().__init__(up=_UP, down=_DOWN)

    def observe(
        self, now_s: float, delivered_bytes: int, *, in_flight_bytes: int, busy: bool, segment_bytes: int
    ) -> None:
        """Measure nothing: of what comes all at once a row of acknowledgements tells too much."""


class Path:
    """The path to one gateway, with what is in flight on it.

    ``sent`` may be called from one thread per lane; all else belongs to the event loop. ``stalled`` is true while
    nothing is acknowledged: such a path holds nobody up.
    """

    def __init__(self) -> None:
        self.model = LinkModel(_PathPace(), _TRAITS)
        self.stalled = False
        self._under_way: list[deque[_Packet]] = [deque() for _ in range(LANES)]
        self._sent_bytes = [0] * LANES  # each changed by its lane's thread alone
        self._delivered_bytes = 0
        self._pending_bytes = 0
        self._rtt_s = self._deviation_s = 0.0
        self._shortest = ShortestRoundTrip()
        self._heard_s = 0.0
        self._copies = CopyBudget()
        self._laden_s = float("-inf")  # when a part of a big message went last
        self._came = (0.0, 0.0)  # when a packet came last, or the first one left, and when that was sent
        self._spread_bytes = 0.0  # what may go at once …
        self._spread_s = 0.0  # … as of then
        self._round_bytes = 0  # what had come when the round trip began

    # ── what goes out ──────────────────────────────────────────────────────────────────────────────────────────

    def hand(self, size_bytes: int) -> None:
        """Note what is on its way to a lane's thread."""
        self._pending_bytes += size_bytes
        self._spread_bytes -= size_bytes
        self.model.handed(size_bytes)

    @property
    def far(self) -> bool:
        """Whether a lost packet costs those behind it a time that matters."""
        return (self.model.base_rtt_s or 0.0) >= _FAST_ROUND_TRIP_S

    def laden(self, now_s: float) -> None:
        """Note that a big message is being sent."""
        self._laden_s = now_s

    def copies(self, publisher: bytes, size_bytes: int, now_s: float) -> bool:
        """Return whether a small packet goes by a bypass, too: big messages that may lose packets go before it."""
        pace = self.model.pace.bytes_per_s
        if pace is None or not self.far or now_s - self._laden_s > _LADEN_S:
            return False
        return self._copies.takes(publisher, size_bytes, pace, now_s)

    def landed(self, size_bytes: int) -> None:
        """Note that the thread has sent it, or failed to."""
        self._pending_bytes -= size_bytes

    def sent(self, lane: int, number: int, size_bytes: int, now_s: float) -> None:
        """Note a packet just before it is put; in the lane's thread."""
        if not any(self._under_way):
            self._came = (now_s, now_s)
        came_s, before_s = self._came
        held = self.model.room_bytes <= 0
        self._under_way[lane].append(_Packet(number, size_bytes, now_s, self._delivered_bytes, came_s, before_s, held))
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
        if fast is not None:
            return max(model.room_bytes, int(_FAST_S * fast) - self.in_flight_bytes)
        return min(model.room_bytes, self._at_once_bytes(now_s))

    def _at_once_bytes(self, now_s: float) -> int:
        """Return how much may go at once: a little more than the path has carried away since something went last."""
        pace, base_s, model = self.model.pace.bytes_per_s, self.model.base_rtt_s, self.model
        passed_s, self._spread_s = now_s - self._spread_s, now_s
        if pace is None or base_s is None or base_s < _FAST_ROUND_TRIP_S or model.starting:
            self._spread_bytes = 0.0
            return _NO_LIMIT
        most = max(_SPREAD_S * pace, _SPREAD_PARTS * self.part_bytes)
        self._spread_bytes = min(self._spread_bytes + _SPREAD_GAIN * pace * passed_s, most)
        return int(self._spread_bytes)

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
        latest: _Packet | None = None
        for lane, number in newest:
            if not 0 <= lane < LANES:
                continue
            under_way = self._under_way[lane]
            while under_way and under_way[0].number <= number:
                packet = under_way.popleft()
                self._delivered_bytes += packet.size_bytes
                if latest is None or packet.sent_s > latest.sent_s:
                    latest = packet
        if latest is None:
            return
        gap_s = now_s - self._heard_s
        self._shortest.passed(gap_s, pause=gap_s > self._slack_s)
        self.stalled, self._heard_s, self._came = False, now_s, (now_s, latest.sent_s)
        self._sample(max(now_s - latest.sent_s, 1e-6))
        if latest.delivered_bytes >= self._round_bytes:
            self._round_bytes = self._delivered_bytes
            self._measure(latest, now_s)
        self.model.observe(self._reading(now_s))

    def _sample(self, rtt_s: float) -> None:
        rounds = (
            0 if self.model.starting else _SAMPLED_ROUND_TRIPS
        )  # while the window doubles a queue is to show at once
        self._shortest.add(rtt_s, rounds * (self.model.base_rtt_s or rtt_s))
        if not self._rtt_s:
            self._rtt_s, self._deviation_s = rtt_s, rtt_s / 2
            return
        self._deviation_s += _DEVIATION_WEIGHT * (abs(rtt_s - self._rtt_s) - self._deviation_s)
        self._rtt_s += _RTT_WEIGHT * (rtt_s - self._rtt_s)

    def _measure(self, latest: _Packet, now_s: float) -> None:
        """Measure the pace of the round trip that this packet ends."""
        size = self._delivered_bytes - latest.delivered_bytes
        seconds = max(now_s - latest.came_s, latest.sent_s - latest.before_s)
        if size >= _TELLING_BYTES or seconds >= _TELLING_S:
            self.model.pace.carried(size, seconds, busy=latest.held)

    @property
    def _slack_s(self) -> float:
        """Return how long after the one before a packet may come that nothing held up."""
        pace = self.model.pace.bytes_per_s
        return _LATE_S if not pace else max(_LATE_S, _LATE_PARTS * self.part_bytes / pace)

    def _late_bytes(self, now_s: float) -> int:
        """Return what has most likely left the link, and waits for a packet that was lost before it."""
        if not self._shortest:
            return 0
        before_s = now_s - self._shortest.rtt_s - self._slack_s
        late = 0
        for under_way in self._under_way:
            for index in range(len(under_way)):  # its lane's thread may add to it meanwhile
                packet = under_way[index]
                if packet.sent_s >= before_s:
                    break
                late += packet.size_bytes
        return late

    def _reading(self, now_s: float) -> LinkReading:
        late = min(self._late_bytes(now_s), int(_MOST_LATE_WINDOWS * self.model.window_bytes))
        return LinkReading(
            now_s,
            self._delivered_bytes,
            max(self.in_flight_bytes - late, 0),
            0,
            self._shortest.rtt_s,
            self._deviation_s,
            0,
            _SEGMENT_BYTES,
        )

    def _is_stalled(self, now_s: float) -> bool:
        oldest_s = min((under_way[0].sent_s for under_way in self._under_way if under_way), default=now_s)
        return now_s - max(oldest_s, self._heard_s) > max(_STALLED_S, _STALLED_ROUND_TRIPS * self._rtt_s)

    def _forget(self) -> None:
        """Count on no acknowledgement of what is under way."""
        for under_way in self._under_way:
            while under_way:
                self._delivered_bytes += under_way.popleft().size_bytes
