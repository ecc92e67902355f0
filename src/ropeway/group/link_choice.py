"""Chooses one of several links to the same place by the round trips of probes, and says when to look. Sans-I/O.

What counts is not the shortest link but the one on which the next message is least likely to be late: the smoothed
round trip and four deviations, as TCP computes its timeout (RFC 6298). A probe that is lost, or late, counts with its
age as soon as that is more. So a link whose round trips vary, or that loses packets, is left before it fails.

A link that may be cut is doubted well before it counts as silent: from then on another one is used ``beside`` it, so
that neither a cut costs the time in which one becomes sure, nor a probe that was merely late a change.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from typing import Any, Final

__all__ = ["BREAK_S", "PROBE_S", "LinkChoice"]

PROBE_S: Final = 0.025
"""The time between two probes of a link: 60 bytes each, 20 kbit/s both ways."""

BREAK_S: Final = 0.3
"""How long a link is still read after a change to another, which begins a round trip later."""

_DOUBTED_S: Final = 0.03  # one probe and a little: a link of a machine that computes for a moment is not doubted
_DOUBTED_LATE_S: Final = 0.01  # so much later than usual
_CALM_S: Final = 0.5  # a link that was doubted is trusted again after so long
_STALLED_S: Final = 0.01  # we looked so much later than was due: answers that have come were not seen yet
_LOOK_AGAIN_S: Final = 0.002  # after which they were
_SILENT_S: Final = 0.08  # three probes that should have come: the link carries nothing now
_MEAN: Final = 1 / 8
_DEVIATION: Final = 1 / 4
_TIMES: Final = 4
_MARGIN: Final = 0.8  # another link must be better by a fifth
_MARGIN_S: Final = 0.002
_DWELL_S: Final = 0.5  # no second change sooner, unless the link in use is silent
_MOST_UNDER_WAY: Final = 1024
_SAME_S: Final = PROBE_S / 4  # a probe is noted about when it is sent


@dataclass(slots=True, eq=False)
class _Link:
    up: bool = False
    mean_s: float | None = None
    deviation_s: float = 0.0
    under_way: deque[float] = field(default_factory=deque)  # when probes were sent that have no answer
    answered_s: float = float("-inf")  # when the last one was sent that has

    @property
    def usual_s(self) -> float:
        """Return within what time answers come."""
        return (self.mean_s or 0.0) + _TIMES * self.deviation_s

    @property
    def doubted_from_s(self) -> float:
        """Return when the link is doubted, if nothing comes until then."""
        if not self.under_way:
            return float("inf")
        return self.under_way[0] + max(_DOUBTED_S, self.usual_s + _DOUBTED_LATE_S)

    def score_s(self, now_s: float) -> float:
        """Return how late a message may be there."""
        if not self.up or self.mean_s is None:
            return float("inf")
        age_s = now_s - self.under_way[0] if self.under_way else 0.0
        return max(self.usual_s, age_s)

    def silent(self, now_s: float) -> bool:
        """Return whether nothing has come for so long that the link is most likely cut."""
        if not self.up or not self.under_way:
            return not self.up
        return now_s - self.under_way[0] > max(_SILENT_S, self.usual_s)

    def doubted(self, now_s: float) -> bool:
        """Return whether the link may be cut: an answer should be there by now."""
        return not self.up or now_s >= self.doubted_from_s


class LinkChoice:
    """Says which of the links ``names`` is to be used: ``best``, and which one ``beside`` it while that may be cut.

    Either is ``""`` for none. All times are of one steady clock.
    """

    def __init__(self, names: Iterable[str]) -> None:
        self.best = self.beside = ""
        self._links = {name: _Link() for name in names}
        self._since_s = float("-inf")
        self._doubted_s = float("-inf")
        self._probe_at_s = float("-inf")
        self._look_at_s = float("inf")
        self._stalled = False

    def up(self, name: str, up: bool) -> None:
        """Note that a link was made, or has ended."""
        self._links[name] = _Link(up)

    def sent(self, name: str, now_s: float) -> None:
        """Note a probe."""
        under_way = self._links[name].under_way
        if len(under_way) < _MOST_UNDER_WAY:
            under_way.append(now_s)

    def came(self, name: str, round_trip_s: float, now_s: float) -> None:
        """Note the answer to a probe; those before it are over as well, as links keep the order."""
        link = self._links[name]
        link.answered_s = max(link.answered_s, now_s - round_trip_s)
        while link.under_way and link.under_way[0] <= now_s - round_trip_s + _SAME_S:
            link.under_way.popleft()
        if link.mean_s is None:
            link.mean_s, link.deviation_s = round_trip_s, round_trip_s / 2
            return
        link.deviation_s += _DEVIATION * (abs(round_trip_s - link.mean_s) - link.deviation_s)
        link.mean_s += _MEAN * (round_trip_s - link.mean_s)

    def silent(self, name: str, now_s: float) -> bool:
        """Return whether a link is down, or most likely cut."""
        return self._links[name].silent(now_s)

    def answered_s(self, name: str) -> float:
        """Return when the last probe was sent that was answered: what was sent by this link before has arrived."""
        return self._links[name].answered_s

    def due(self, now_s: float) -> bool:
        """Return whether every link is to be probed now."""
        if now_s < self._probe_at_s:
            return False
        self._probe_at_s = now_s + PROBE_S
        return True

    def pause_s(self, now_s: float) -> float:
        """Return after how long to look again: for the next probes, or when the link in use comes to be doubted."""
        at_s, current = self._probe_at_s, self._links.get(self.best)
        if self._stalled:
            at_s = now_s
        elif current is not None and now_s < current.doubted_from_s < at_s:
            at_s = current.doubted_from_s
        self._look_at_s = max(at_s, now_s + _LOOK_AGAIN_S)
        return self._look_at_s - now_s

    def step(self, now_s: float) -> str:
        """Return the link to use from now on, ``""`` while there is none."""
        self._stalled = now_s - self._look_at_s > _STALLED_S
        current, before = self._links.get(self.best), self.best
        if self._stalled and current is not None and current.up:
            return before
        self._choose(now_s)
        if self.best != before:
            self.beside = ""
        self._doubt(now_s)
        return self.best

    def _doubt(self, now_s: float) -> None:
        """Use another link beside one that is doubted, until that has answered for a while."""
        current = self._links.get(self.best)
        if current is not None and current.doubted(now_s):
            trusted = [name for name, link in self._links.items() if link.up and not link.doubted(now_s)]
            if self.beside not in trusted:
                self.beside = min(trusted, key=lambda name: self._links[name].score_s(now_s), default="")
            self._doubted_s = now_s
        elif now_s - self._doubted_s >= _CALM_S:
            self.beside = ""

    def _choose(self, now_s: float) -> None:
        current = self._links.get(self.best)
        name, link = min(self._links.items(), key=lambda item: item[1].score_s(now_s))
        if current is None or not current.up:
            first = next((n for n, other in self._links.items() if other.up), "")
            self._use(name if link.score_s(now_s) < float("inf") else first, now_s)
        elif link is not current:
            mine_s, other_s = current.score_s(now_s), link.score_s(now_s)
            better = other_s < _MARGIN * mine_s and other_s < mine_s - _MARGIN_S
            rested = now_s - self._since_s >= _DWELL_S
            if (current.silent(now_s) and not link.silent(now_s)) or (better and rested):
                self._use(name, now_s)

    def _use(self, name: str, now_s: float) -> None:
        if name != self.best:
            self.best, self._since_s = name, now_s

    def status(self, now_s: float) -> Mapping[str, Any]:
        """Return the links as they stand, as JSON."""
        return {
            name: {
                "up": link.up,
                "silent": link.silent(now_s),
                "rtt_ms": None if link.mean_s is None else round(1e3 * link.mean_s, 3),
                "deviation_ms": round(1e3 * link.deviation_s, 3),
            }
            for name, link in self._links.items()
        }
