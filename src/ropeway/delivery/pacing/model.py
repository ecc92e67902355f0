"""A model of a link: how much may be on the way, so that the link is busy and no queue builds up.

TCP queues what it is given: in its own buffer, in the network device, in every router on the way. A message behind
such a queue is old before it leaves. So only as much is handed to TCP as the link needs to stay busy over its round
trip, and a little more. Two figures bound it:

* the **window**, what may be on the way. Its law is that of FAST TCP (Wei, Jin, Low and Hegde, 2006): while it holds
  us back, ``window * (shortest round trip + target) / round trip`` leaves a queue of ``target`` seconds at the
  narrowest place, whatever its rate. Where no queue builds up, the window is too small: it doubles at the start and
  grows every other round trip later, little at first and then ever more, as a change shows a round trip after it was
  made.
* what is **unsent**, handed to the kernel and not yet on the way: only what the link carries away before we look again.

The shortest round trip is forgotten after a while, as routes change; while we fill the link ourselves, a part of the
window is left unused for three round trips every five seconds, to see it again. Whether a queue is ours at all,
``ropeway.delivery.pacing.competition`` tells.

There is no input or output here: readings go in, bounds come out. A simulated link tests it.
"""

from __future__ import annotations

from typing import Final, NamedTuple

from ropeway.delivery.pacing.competition import Advice, Competition, Situation
from ropeway.delivery.pacing.pace import Pace
from ropeway.delivery.pacing.rounds import LinkReading, Round, RoundTripBounds

__all__ = ["LinkModel", "LinkTraits"]

_FIRST_WINDOW_BYTES: Final = 16 * 1024  # what TCP itself begins with
_LEAST_WINDOW_BYTES: Final = 4 * 1024
_MOST_WINDOW_BYTES: Final = 64 << 20
_LEAST_QUEUE_S: Final = 0.002  # timers have a resolution of 1 ms
_MOST_QUEUE_S: Final = 0.005
_QUEUE_SHARE: Final = 0.05  # of the round trip
_KEPT_SEGMENTS: Final = 0.75  # keep a slow link busy, as the kernel spreads them
_CLEAN_S: Final = 2.0  # others who fill a link lose packets, theirs and ours
_FAR_SEGMENTS: Final = 4  # are on the way at once at least, for the kernel to spread them
_MOST_QUEUE_SHARE: Final = 0.25  # where round trips vary
_FIRST_STEP: Final = 0.05  # of the window, where no queue builds up; twice as much each time it still does not
_LEAP: Final = 2.0  # where the pace says that there is room, and at most
_LEAST_LEAP: Final = 1.25
_SPREAD_GAIN: Final = 1.25
_CAUTIOUS_STEPS: Final = 3  # of the window's growth; a slow link that has no queue after them has become faster
_LONG_ROUND_TRIP_S: Final = 0.005  # below, the window is what processors need
_NEAR_S: Final = 0.001
_BASE_MEMORY_S: Final = 5.0  # the shortest round trip is that of five to ten seconds
_SMOOTHING_SEGMENTS: Final = 16  # after so many little is left of the first round trip in a smoothed one
_LUCK: Final = 2.0  # deviations, by which it may have been shorter than the others
_MOST_LUCK: Final = 0.2  # of it: more is a queue
_DRAIN_ROUNDS: Final = 3
_LEAST_DRAINED: Final = 0.5  # of the window is used while we look for the shortest round trip
_CUT: Final = 0.8  # of the window is left after a cut that should show
_UNSENT_S: Final = 0.004  # what the kernel may hold back: four looks of the shortest kind
_MOST_UNSENT_S: Final = 0.016  # where processors are busy, and we look late
_LATE: Final = 1.25
_FULL: Final = 2.0  # times the shortest round trip, and a long queue: the start has gone too far
_FORGET: Final = 0.99  # per hand-over
_LONG_QUEUE: Final = 3.0  # targets
_LONG_SHARE: Final = 0.25  # of the round trip
_LEAST_UNSENT_BYTES: Final = 8 * 1024
_FIRST_UNSENT_BYTES: Final = 16 * 1024
_SHORTEST_LOOK_S: Final = 0.001
_LONGEST_LOOK_S: Final = 0.02
_LOSSY_ROUNDS: Final = 3  # of the last sixteen: losses without a queue are no sign of a full link
_LOSS_MEMORY: Final = 0xFFFF


class LinkTraits(NamedTuple):
    """Describes how a path differs from a TCP connection of ours, of which the kernel tells everything.

    ``part_bytes`` are handed over at once, at least, and not spread by the kernel. Round trips vary by ``slack_s`` for
    reasons that have nothing to do with the link, and a queue that becomes longer shows in them after ``echo_rounds``.
    The window is at most ``most_windows`` times what the pace fills.
    """

    part_bytes: int = 0
    slack_s: float = 0.0
    echo_rounds: int = 1
    most_windows: float = float("inf")


_OURS: Final = LinkTraits()


class LinkModel:
    """The model of one connection.

    Call ``handed`` for what is sent and ``observe`` with readings; ``room_bytes`` tells how much may be sent now, and
    ``look_in_s`` when to read again.
    """

    def __init__(self, pace: Pace | None = None, traits: LinkTraits = _OURS) -> None:
        self.pace = pace or Pace()
        self._traits = traits
        self.window_bytes = _FIRST_WINDOW_BYTES
        self.room_bytes = _FIRST_UNSENT_BYTES
        self.outstanding_bytes = 0
        self.base_rtt_s: float | None = None
        self.queue_s = 0.0
        self.starting = True
        """The link was never seen full: its pace is a lower bound."""
        self.losing = False
        """Messages are lost on a link that is not full: a congestion control that takes losses for a full link
        wastes it."""
        self._unsent_bytes = 0
        self._unsent_s = _UNSENT_S
        self._by_kernel = False  # it, and not the window, holds back what is sent
        self._largest_bytes = 0.0  # of what was handed over at once
        self._segment_bytes = 1
        self._least_bytes = _LEAST_WINDOW_BYTES
        self._quiet = 0
        self._base_slots = [float("inf"), float("inf")]  # the shortest of the slot before and of this one
        self._smooth_from: int | None = None
        self._slot_ends_s = float("-inf")
        self._held_in_slot = False
        self._drain_rounds = 0
        self._settling = 0
        self._slow_start = False  # the start has begun to make a queue
        self._round: Round | None = None
        self._bounds = RoundTripBounds()
        self._others = Competition(precise=not traits.slack_s)
        self._lossy_rounds = 0
        self._lost_s: float | None = None
        self._clean_s = 0.0  # since a packet was lost, or since the first reading
        self._retransmissions = 0

    @property
    def bytes_per_s(self) -> float | None:
        """Return the pace of the link, ``None`` until it was seen full: before, the pace is what we have sent."""
        return None if self.starting and self.near else self.pace.bytes_per_s

    @property
    def near(self) -> bool:
        """Return whether the other end is on this machine or the next: processors are what takes time."""
        return self.base_rtt_s is not None and self.base_rtt_s < _NEAR_S

    @property
    def wanted_bps(self) -> float | None:
        """The rate at which data in flight can leave: at least the pace, and more if the window has grown beyond it.

        What waits in the kernel must not hold back a window that grows: the pace would only show our own limit.
        """
        pace, base_s = self.pace.bytes_per_s, self.base_rtt_s
        if pace is None or base_s is None or base_s < _LONG_ROUND_TRIP_S:
            return pace
        return max(pace, self.window_bytes / base_s)

    @property
    def spread_gain(self) -> float:
        """The factor by which TCP is to send faster than ``wanted_bps``, so that a faster link shows.

        On a slow link not at all, unless its window keeps growing: what is ahead waits here then, and not before a
        packet of another connection.
        """
        return 1.0 if self._slow and self._quiet <= _CAUTIOUS_STEPS else _SPREAD_GAIN

    @property
    def _slow(self) -> bool:
        """Whether a segment is a queue on a far link that we have to ourselves."""
        pace, base_s = self.pace.bytes_per_s, self.base_rtt_s
        if pace is None or base_s is None or self._traits.slack_s or self._others.competing or self._others.tested:
            return False
        if self._clean_s < _CLEAN_S or self.queue_s >= _MOST_QUEUE_SHARE * base_s:
            return False
        segment_s = self._segment_bytes / pace
        return segment_s >= _LEAST_QUEUE_S and base_s >= _FAR_SEGMENTS * segment_s

    @property
    def unsent_limit_bytes(self) -> int:
        """The number of bytes that may wait in the kernel."""
        least = max(_LEAST_UNSENT_BYTES, self._least_bytes)
        pace = self.wanted_bps
        if self.starting or pace is None:
            least = max(_FIRST_UNSENT_BYTES, self.window_bytes // (1 if self.near else 4))
        return least if pace is None else max(int(pace * self._unsent_s), least)

    @property
    def target_queue_s(self) -> float:
        """The queue that keeps the link busy between two looks."""
        pace, base_s = self.pace.bytes_per_s, self.base_rtt_s or 0.0
        if pace is not None and self._slow:
            return _KEPT_SEGMENTS * self._segment_bytes / pace
        target_s = max(_LEAST_QUEUE_S, min(_QUEUE_SHARE * base_s, _MOST_QUEUE_S))
        if pace is not None:  # segments go and are told of in pairs
            target_s = max(target_s, max(self._traits.part_bytes, self._segment_bytes) / pace)
        return target_s + self._traits.slack_s

    @property
    def _long_queue_s(self) -> float:
        """A queue that we did not want."""
        return max(_LONG_QUEUE * max(self.target_queue_s, _MOST_QUEUE_S), _LONG_SHARE * (self.base_rtt_s or 0.0))

    @property
    def look_in_s(self) -> float:
        """The time from the last ``observe`` to the next reading."""
        pace = self.wanted_bps
        if pace is None or self.starting:
            return _SHORTEST_LOOK_S
        half = self.unsent_limit_bytes // 2
        step = min(half, max(int(pace * _UNSENT_S / 2), self._segment_bytes))
        excess = max(self._unsent_bytes - half, self.outstanding_bytes - self._allowed_bytes + step)
        return min(max(excess / pace, _SHORTEST_LOOK_S), _LONGEST_LOOK_S)

    @property
    def _allowed_bytes(self) -> int:
        if not self._drain_rounds or self.base_rtt_s is None:
            return self.window_bytes
        base, target = self.base_rtt_s, self.target_queue_s
        share = max((base - 2 * target) / (base + target), _LEAST_DRAINED)
        return int(max(share * self.window_bytes, self._least_bytes))

    def handed(self, size_bytes: int) -> None:
        """Note what was handed to the kernel since the last reading."""
        self.room_bytes -= size_bytes
        self.outstanding_bytes += size_bytes
        self._largest_bytes = max(size_bytes, self._largest_bytes * _FORGET)

    def squeezed(self) -> bool:
        """Return, once, whether the congestion control is to forget its losses: others fill the link, and not we."""
        squeezed, self._others.squeezed = self._others.squeezed, False
        return squeezed

    def observe(self, reading: LinkReading) -> None:
        """Take a reading: learn from it, and set ``room_bytes``."""
        now = reading.now_s
        self._segment_bytes = reading.segment_bytes
        self._least_bytes = max(_LEAST_WINDOW_BYTES, 2 * reading.segment_bytes)
        self.window_bytes = max(self.window_bytes, self._least_bytes)
        self._unsent_bytes = reading.unsent_bytes
        self.outstanding_bytes = reading.in_flight_bytes + reading.unsent_bytes
        if reading.rtt_s > 0:
            self._note_round_trip(reading.rtt_s, now)
            self._smooth(reading)
            self._cut_at_once(reading.rtt_s)
        held = self.room_bytes <= 0  # there was more to send than we let out
        far = (self.base_rtt_s or 0.0) >= _LONG_ROUND_TRIP_S
        if held and self._by_kernel and far and not reading.unsent_bytes:  # we looked too late, and the link was idle
            self._unsent_s = min(_LATE * self._unsent_s, _MOST_UNSENT_S)
        else:
            self._unsent_s = max(_FORGET * self._unsent_s, _UNSENT_S)
        by_window = self._allowed_bytes - self.outstanding_bytes
        by_kernel = self.unsent_limit_bytes - reading.unsent_bytes
        self.room_bytes = min(by_window, by_kernel)
        self._by_kernel = by_kernel < by_window
        self.pace.observe(
            now,
            reading.delivered_bytes,
            in_flight_bytes=reading.in_flight_bytes,
            busy=reading.unsent_bytes > 0 or (held and self._is_queued(reading.rtt_s)),
            segment_bytes=reading.segment_bytes,
        )
        self._note_round(reading, by_window <= 0, by_kernel <= 0)

    def _is_queued(self, rtt_s: float) -> bool:
        return self.base_rtt_s is not None and rtt_s > self.base_rtt_s + self.target_queue_s / 2

    # ── the shortest round trip ────────────────────────────────────────────────────────────────────────────────

    def _note_round_trip(self, rtt_s: float, now: float) -> None:
        slots = self._base_slots
        if now >= self._slot_ends_s:
            self._slot_ends_s = now + _BASE_MEMORY_S
            slots[0], slots[1] = slots[1], rtt_s
            drain = self._held_in_slot and not self._others.tested
            self._drain_rounds, self._held_in_slot = (_DRAIN_ROUNDS if drain else 0), False
        else:
            slots[1] = min(slots[1], rtt_s)
        before_s, self.base_rtt_s = self.base_rtt_s, min(slots)
        if before_s is not None and self.base_rtt_s > before_s + _LONG_QUEUE * _MOST_QUEUE_S:
            self._take(self._others.hold(now, self.pace.bytes_per_s or 0.0, before_s, self.base_rtt_s))

    def _smooth(self, reading: LinkReading) -> None:
        """Forget the first round trip once there are enough to smooth: it is a single one, and may have been lucky."""
        base_s = self.base_rtt_s
        if self._smooth_from is None:
            self._smooth_from = reading.delivered_bytes + _SMOOTHING_SEGMENTS * reading.segment_bytes
        elif base_s is not None and 0 <= self._smooth_from <= reading.delivered_bytes:
            self._smooth_from = -1
            luck_s = min(_LUCK * reading.rtt_deviation_s, _MOST_LUCK * base_s)
            self.base_rtt_s = max(base_s, min(reading.rtt_s, base_s + luck_s))
            self._base_slots = [self.base_rtt_s, self.base_rtt_s]

    # ── rounds ─────────────────────────────────────────────────────────────────────────────────────────────────

    def _note_round(self, reading: LinkReading, held: bool, kernel_holds: bool) -> None:
        if not self._traits.slack_s:  # elsewhere round trips are not smoothed
            self._bounds.observe(reading)
        current = self._round
        if current is None:
            if self.outstanding_bytes:
                self._round = Round(reading, self.outstanding_bytes)
            return
        current.note(reading, self._bounds, held=held, kernel_holds=kernel_holds)
        if not current.is_over(reading):
            return
        self._end_round(current, reading)
        self._round = Round(reading, self.outstanding_bytes)

    def _end_round(self, ended: Round, reading: LinkReading) -> None:
        lost = reading.retransmissions > self._retransmissions
        self._retransmissions = reading.retransmissions
        if lost or self._lost_s is None:
            self._lost_s = reading.now_s
        self._clean_s = reading.now_s - self._lost_s
        if lost:
            self._others.lost()
        base = self.base_rtt_s
        if base is None:
            return
        queue_s = self.queue_s = max(0.0, ended.shortest_s(reading) - base)
        target_s = self._tolerated_s(ended.deviation_s)
        slow, self._slow_start = self._slow_start, self.starting and ended.least_s - base >= max(_MOST_QUEUE_S, base)
        if slow and self._slow_start:  # the smoothed round trip, which was short, does not show it yet
            queue_s = self.queue_s = max(queue_s, ended.least_s - base)
        shallow_s = max(target_s, _MOST_QUEUE_SHARE * base)
        full = queue_s >= shallow_s or self._others.competing
        self._lossy_rounds = (self._lossy_rounds << 1 | (lost and not full)) & _LOSS_MEMORY
        self.losing = self._lossy_rounds.bit_count() >= _LOSSY_ROUNDS
        if queue_s < shallow_s:
            self._others.calm(self.pace.bytes_per_s or 0.0)
        if self._drain_rounds:
            self._drain_rounds -= 1
            self._settling = 1
        elif ended.held:
            self._held_in_slot = True
            if self.outstanding_bytes > 1.1 * self.window_bytes + self._least_bytes + self._largest_bytes:
                self._settling = 1  # what was sent before a cut is still on the way
            elif queue_s < self._no_queue_s(target_s):
                if not self._slow_start:
                    self._grow(base + target_s)
            elif self._settling:
                self._settling -= 1  # what arrived was sent before the last change
            else:
                self._fit(reading.now_s, base, queue_s, target_s)
        elif ended.kernel_held:
            self._set_window(min(self.window_bytes, 2 * ended.most_bytes))  # it must not lie in wait far above
            situation = self._situation(reading.now_s, ended.most_bytes, queue_s, target_s)
            advice = None if situation is None else self._others.held_back(situation)
            if advice is not None:
                self._take(advice)
        elif full and base >= _LONG_ROUND_TRIP_S and not self._others.competing:
            self._narrow(base + target_s)

    def _narrow(self, busy_s: float) -> None:
        """Cut a window that is too wide though it holds nobody back: messages that fit it make a queue."""
        pace = self.pace.bytes_per_s
        if pace is not None and pace * busy_s < self.window_bytes:
            self.starting = False
            self._set_window(pace * busy_s)

    def _no_queue_s(self, target_s: float) -> float:
        """Return the queue below which the window is too small; beside others who fill the link none says so."""
        if self._others.competing:
            return 0.0
        return max(target_s, _MOST_QUEUE_S) if self.starting else target_s / 2

    def _grow(self, busy_s: float) -> None:
        """Widen the window: the link is not full."""
        pace = self.pace.bytes_per_s
        below = pace is None or self.window_bytes < pace * busy_s
        if self._settling and not (below and self.starting):
            self._settling -= 1
            return
        self._quiet += 1
        step = _LEAP if below else min(1 + _FIRST_STEP * 2 ** (self._quiet - 1), _LEAP)
        wider = step * self.window_bytes
        if below and pace is not None:
            wider = min(wider, max(pace * busy_s, _LEAST_LEAP * self.window_bytes))
        self._set_window(wider)

    def _cut_at_once(self, rtt_s: float) -> None:
        """Cut a window that is far too wide, without waiting for the end of the round."""
        base, pace, others = self.base_rtt_s, self.pace.bytes_per_s, self._others
        if base is None or pace is None:
            return
        others.saw(rtt_s - base)
        if rtt_s < base + self._long_queue_s:
            return
        if self.starting:
            if rtt_s < _FULL * base + _LONG_QUEUE * _MOST_QUEUE_S:
                return
            self.starting = False
        wanted = max(pace * (base + self.target_queue_s), self._least_bytes, others.least_cut_bytes())
        if wanted < _CUT * self.window_bytes:
            others.test(self.window_bytes, pace, rtt_s - base, base)
            self._set_window(wanted)

    def _tolerated_s(self, deviation_s: float) -> float:
        """Return the queue that is left: more than the target where round trips vary."""
        return max(self.target_queue_s, min(2 * deviation_s, _MOST_QUEUE_SHARE * (self.base_rtt_s or 0.0)))

    def _fit(self, now_s: float, base_s: float, queue_s: float, target_s: float) -> None:
        """Fit the window to a full link, so that a queue of ``target_s`` is left, or as others on it demand."""
        self._quiet = 0
        self.starting = False
        window, others = self.window_bytes, self._others
        now = self._situation(now_s, window, queue_s, target_s)
        if now is not None:
            advice = others.advise(now)
            if advice is not None:
                self._take(advice)
                return
        wanted = window * (base_s + target_s) / (base_s + queue_s)
        kept = max(window if others.competing else 0, others.kept_bytes(now_s, base_s))
        self._set_window(max(wanted, kept))

    def _situation(self, now_s: float, window_bytes: int, queue_s: float, target_s: float) -> Situation | None:
        pace, base_s = self.pace.bytes_per_s, self.base_rtt_s
        if pace is None or base_s is None:
            return None
        return Situation(now_s, window_bytes, self._least_bytes, pace, base_s, queue_s, target_s, self._long_queue_s)

    def _take(self, advice: Advice) -> None:
        if advice.base_s is not None:
            self._base_slots = [advice.base_s, advice.base_s]
            self.base_rtt_s = advice.base_s
        self._set_window(advice.window_bytes)

    def _set_window(self, size_bytes: float) -> None:
        pace, base_s, before = self.pace.bytes_per_s, self.base_rtt_s, self.window_bytes
        if pace is not None and base_s is not None and not self.starting:
            size_bytes = min(size_bytes, self._traits.most_windows * pace * (base_s + self.target_queue_s))
        self.window_bytes = int(min(max(size_bytes, self._least_bytes), _MOST_WINDOW_BYTES))
        self._settling = self._traits.echo_rounds if self.window_bytes > before else 1
