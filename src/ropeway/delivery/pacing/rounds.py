"""Follows a connection from round trip to round trip: how long the shortest of each was, and how much arrived."""

from __future__ import annotations

from typing import Final, NamedTuple

__all__ = ["LinkReading", "Round", "RoundTripBounds"]

_SHORTEST_ROUND_S: Final = 0.01  # below, a round trip says more of the processor than of the link
_SHORTEST_ROUND_SEGMENTS: Final = 16  # with fewer the smoothed round trip is still that of before
_LONGEST_ROUND_TRIPS: Final = 4
_LATE_SEGMENTS: Final = 2  # fewer the other end may acknowledge late


class LinkReading(NamedTuple):
    """The state of a connection at one moment; counts are since its beginning.

    ``delivered_bytes`` have arrived (acknowledged, also selectively), ``in_flight_bytes`` are on the way,
    ``unsent_bytes`` were handed over and wait in the kernel. ``rtt_s`` is the smoothed round trip.
    """

    now_s: float
    delivered_bytes: int
    in_flight_bytes: int
    unsent_bytes: int
    rtt_s: float
    rtt_deviation_s: float
    retransmissions: int
    segment_bytes: int


class RoundTripBounds:
    """Bounds the round trip of now, which the kernel's smoothed one follows late.

    What was in flight at one reading and still is takes at least the time between them; what was not sent at one
    reading and has arrived at another takes at most that.
    """

    __slots__ = (
        "_flying_bytes",
        "_flying_s",
        "_retransmissions",
        "_unsent_from_bytes",
        "_unsent_s",
        "at_least_s",
        "at_most_s",
    )

    def __init__(self) -> None:
        self.at_least_s = 0.0
        self.at_most_s = float("inf")
        self._flying_s = self._unsent_s = 0.0
        self._flying_bytes = self._unsent_from_bytes = self._retransmissions = -1

    def observe(self, reading: LinkReading) -> None:
        """Take a reading: the bounds are those that it shows."""
        now_s, delivered_bytes = reading.now_s, reading.delivered_bytes
        sent_bytes = delivered_bytes + reading.in_flight_bytes
        self.at_least_s, self.at_most_s = 0.0, float("inf")
        if self._retransmissions != reading.retransmissions:  # which bytes arrived is not sure
            self._retransmissions = reading.retransmissions
            self._flying_bytes = self._unsent_from_bytes = -1
        if delivered_bytes < self._flying_bytes:
            self.at_least_s = now_s - self._flying_s
        else:
            self._flying_s, self._flying_bytes = now_s, sent_bytes - _LATE_SEGMENTS * reading.segment_bytes
        if 0 <= self._unsent_from_bytes <= delivered_bytes - reading.segment_bytes:
            self.at_most_s = now_s - self._unsent_s
            self._unsent_from_bytes = -1
        if sent_bytes <= self._unsent_from_bytes or self._unsent_from_bytes < 0:
            self._unsent_s, self._unsent_from_bytes = now_s, sent_bytes


class Round:
    """A round trip: what was in flight or unsent at its beginning has arrived at its end.

    Some of it took ``least_s`` at least.
    """

    __slots__ = (
        "_began_s",
        "_bound_s",
        "_from_bytes",
        "_smoothed_s",
        "_until_bytes",
        "deviation_s",
        "held",
        "kernel_held",
        "least_s",
        "most_bytes",
    )

    def __init__(self, reading: LinkReading, outstanding_bytes: int) -> None:
        self._began_s = reading.now_s
        self._from_bytes = reading.delivered_bytes
        self._until_bytes = reading.delivered_bytes + outstanding_bytes
        self._smoothed_s = self._bound_s = float("inf")
        self.least_s = 0.0
        self.held = self.kernel_held = False
        self.deviation_s = reading.rtt_deviation_s
        self.most_bytes = reading.in_flight_bytes

    def is_over(self, reading: LinkReading) -> bool:
        """Return whether what was on the way has arrived, and enough of it to know the round trip."""
        seconds = reading.now_s - self._began_s
        if reading.delivered_bytes < self._until_bytes or seconds < _SHORTEST_ROUND_S:
            return False
        return (
            self._is_telling(reading) or seconds >= _LONGEST_ROUND_TRIPS * reading.rtt_s or not reading.in_flight_bytes
        )

    def _is_telling(self, reading: LinkReading) -> bool:
        arrived = reading.delivered_bytes - self._from_bytes
        return arrived >= _SHORTEST_ROUND_SEGMENTS * reading.segment_bytes

    def shortest_s(self, reading: LinkReading) -> float:
        """Return the shortest round trip of one that is over."""
        return self._smoothed_s if self._is_telling(reading) else min(self._smoothed_s, self._bound_s)

    def note(self, reading: LinkReading, bounds: RoundTripBounds, *, held: bool, kernel_holds: bool) -> None:
        """Take a reading within the round, and the bounds of the round trip that it shows."""
        self.held = self.held or held
        self.kernel_held = self.kernel_held or kernel_holds
        self._smoothed_s = min(self._smoothed_s, reading.rtt_s)
        self.least_s = max(self.least_s, bounds.at_least_s)
        self._bound_s = min(self._bound_s, bounds.at_most_s)
        self.deviation_s = min(self.deviation_s, reading.rtt_deviation_s)
        self.most_bytes = max(self.most_bytes, reading.in_flight_bytes)
