"""Decides which member of a group gets the requests. Sans-I/O: the gateway and the simulator use the same object.

The best member is found once, at the start, by asking each for a moment. From then on nothing is tried without a
reason: the member in use must miss the bound, or be gone. Latencies of compressed video rise and fall together on all
machines, so windows of different times say little; what is compared is *pairs*, the same request to two members. While
the bound is missed the two best get each request and the first answer wins, which is never later than either alone
would have been. That needs requests that may be carried out twice (``stateless``); where they may not, the other is
tried instead of the one in use, and if it proves worse the way back is at once.

A member that lost a comparison is left alone for a time that doubles with each loss, so that one that flaps is not
followed.
"""

from __future__ import annotations

import enum
import statistics
from collections import deque
from collections.abc import Hashable, Sequence
from dataclasses import dataclass, field
from typing import Any, Final, NamedTuple

from ropeway.group.bound import LatencyBound, Standing
from ropeway.group.latency import WINDOW_S, LatencyWindow

__all__ = ["Decision", "Options", "Phase", "Scheduler"]

_LATE_IN_A_ROW: Final = 2  # requests above the limit, one after the other, that start a comparison: one may be a hiccup
_ENOUGH: Final = 4  # times the pairs that may show one side late: to compare means, or to give a rival up
_JUDGED_PER_WINDOW: Final = 50  # what two requests in a row do not show, shows in a window, and not sooner
_TELLING: Final = 2  # late requests more than the rival's, of as many: one more may be chance
_MOST_DECISIONS: Final = 256
_MOST_PENALTY_S: Final = 300.0


@dataclass(frozen=True, slots=True, kw_only=True)
class Options:
    """Configures how a scheduler decides.

    ``profile_s``: how long each member is asked alone at the start (100 ms in the thesis). ``pairs``: how many requests
    two members must both have had before they are compared. ``margin``: by how much of its latency the one in use must
    be beaten. ``least_dwell_s``: no second change sooner, unless the member is gone or the change proves wrong.
    ``penalty_s``: how long the loser of a comparison is left alone, doubled with each loss; after ``forgive_s`` without
    one it starts anew.
    """

    window_s: float = WINDOW_S
    profile_s: float = 0.1
    pairs: int = 4
    margin: float = 0.1
    least_dwell_s: float = 1.0
    penalty_s: float = 2.0
    forgive_s: float = 60.0


class Phase(enum.Enum):
    """The activity of a scheduler."""

    IDLE = "no member is there"
    PROFILING = "each member is asked for a moment"
    STEADY = "one member is asked"
    COMPARING = "two members are compared"


@dataclass(frozen=True, slots=True)
class Decision:
    """A change of the member in use, or one that was thought of: why, and on which numbers."""

    at_s: float
    before: str
    after: str
    why: str

    def __str__(self) -> str:
        change = f"{self.before or 'nobody'} → {self.after or 'nobody'}" if self.before != self.after else self.after
        return f"{change}: {self.why}"


@dataclass(slots=True, eq=False)
class _Member:
    name: str
    window: LatencyWindow
    here: bool = False
    late: int = 0  # requests above the limit, one after the other
    penalty_s: float = 0.0
    alone_until_s: float = 0.0
    lost_at_s: float = float("-inf")
    known_s: float | None = None  # the median when it was asked last, which outlives its window


@dataclass(slots=True, eq=False)
class _Comparison:
    """Requests that two members had at the same time: how long each took, ``None`` while it is open."""

    rival: str
    asked: dict[Hashable, float] = field(default_factory=dict)
    took: dict[Hashable, dict[str, float]] = field(default_factory=dict)

    def pairs(self, now_s: float, mine: str) -> list[tuple[float, float]]:
        """Return what the one in use and the rival took; an answer that is missing takes at least until now."""
        found = []
        for key, took in self.took.items():
            if took:
                age_s = now_s - self.asked[key]
                found.append((took.get(mine, age_s), took.get(self.rival, age_s)))
        return found


class _Side(NamedTuple):
    """The result of one side of a comparison: requests above the limit, and the mean."""

    late: int
    mean_s: float


class Scheduler:
    """Chooses among ``names``; see the module.

    Tell it when members come and go (``came``, ``left``), what was sent to whom (``asked``) and what came back
    (``answered``), or latencies that were measured elsewhere (``measured``); ask ``targets`` for who gets the next
    request. All times are of one steady clock. ``decisions`` keeps the last ones, with their reasons.
    """

    def __init__(
        self,
        names: Sequence[str],
        bound: LatencyBound = LatencyBound(),  # noqa: B008 - frozen
        *,
        stateless: bool = False,
        options: Options = Options(),
    ) -> None:
        self.bound, self.stateless, self.options = bound, stateless, options
        self.current = ""
        self.held = False  # by hand: nothing is switched
        self.decisions: deque[Decision] = deque(maxlen=_MOST_DECISIONS)
        self.decided = 0  # in all
        self._members = {name: _Member(name, LatencyWindow(options.window_s)) for name in names}
        self._since_s = float("-inf")
        self._to_profile: list[str] = []
        self._profile_ends_s = 0.0
        self._profiled = False
        self._comparison: _Comparison | None = None
        self._judge_at_s = float("-inf")
        self._came_from = ""  # where the last change came from, while it is on probation

    # ── what is ────────────────────────────────────────────────────────────────────────────────────────────────

    @property
    def phase(self) -> Phase:
        """Return what it is doing."""
        if self._to_profile:
            return Phase.PROFILING
        if self._comparison is not None:
            return Phase.COMPARING
        return Phase.STEADY if self.current else Phase.IDLE

    @property
    def here(self) -> list[str]:
        """Return the members that are there, in the order of the configuration."""
        return [member.name for member in self._members.values() if member.here]

    def window(self, name: str) -> LatencyWindow:
        """Return the latencies of a member."""
        return self._members[name].window

    def targets(self, now_s: float) -> tuple[str, ...]:
        """Return who gets the next request; more than one only where requests may be carried out twice."""
        self.step(now_s)
        if self._to_profile:
            return (self._to_profile[0],)
        if self._comparison is not None and self.stateless:
            return (self.current, self._comparison.rival)
        return (self.current,) if self.current else ()

    def ranked(self, now_s: float) -> list[str]:
        """Return the members that are there, the one in use first, then the most promising."""
        others = [m for m in self._members.values() if m.here and m.name != self.current]
        others.sort(key=lambda m: self._rank(m, now_s))
        return [*([self.current] if self.current else []), *(m.name for m in others)]

    def status(self, now_s: float) -> dict[str, Any]:
        """Return everything as it stands, as JSON."""
        return {
            "current": self.current,
            "phase": self.phase.name.lower(),
            "held": self.held,
            "members": {
                m.name: {
                    "here": m.here,
                    "standing": self.bound.judge(found).value,
                    "latency_s": None if found is None else found.as_json(),
                    "alone_for_s": round(max(0.0, m.alone_until_s - now_s), 3),
                }
                for m in self._members.values()
                for found in (m.window.statistics(now_s),)
            },
            "decisions": [str(decision) for decision in list(self.decisions)[-8:]],
        }

    # ── what happens ───────────────────────────────────────────────────────────────────────────────────────────

    def came(self, name: str, now_s: float) -> None:
        """Add a member that is there."""
        member = self._members[name]
        if member.here:
            return
        member.here, member.late, member.known_s = True, 0, None
        member.window.clear()
        if not self.current:
            self._change(name, now_s, "the first that is there")
        if self._to_profile:
            self._to_profile.append(name)

    def left(self, name: str, now_s: float) -> None:
        """Remove a member that is gone: the next request goes to the most promising of the others."""
        member = self._members[name]
        if not member.here:
            return
        member.here = False
        member.window.clear()
        if name in self._to_profile:
            first = self._to_profile[0] == name
            self._to_profile.remove(name)
            self._profile_ends_s = now_s + self.options.profile_s if first else self._profile_ends_s
        if self._comparison is not None and name in (self._comparison.rival, self.current):
            self._comparison = None
        if self._came_from == name:
            self._came_from = ""
        if name == self.current:
            after = next(iter(self.ranked(now_s)[1:]), "")
            self._change(after, now_s, f"{name} is gone" if after else f"{name} is gone, and nobody else is there")

    def profile(self, now_s: float) -> None:
        """Ask each member that is there for a moment, then choose: at the start, and when somebody wants it."""
        self._profiled = True
        self._comparison, self._came_from = None, ""
        self._to_profile = self.here if len(self.here) > 1 else []
        self._profile_ends_s = now_s + self.options.profile_s

    def asked(self, names: Sequence[str], key: Hashable, now_s: float) -> None:
        """Note that a request was sent to ``names``."""
        if not self._profiled and self.bound.limits:
            self.profile(now_s)
        for name in names:
            self._members[name].window.asked(now_s, key)
        comparison = self._comparison
        if comparison is not None and len(names) > 1:
            comparison.asked[key], comparison.took[key] = now_s, {}

    def answered(self, name: str, key: Hashable, now_s: float) -> float | None:
        """Note a member's answer; return how long it took, ``None`` if the member was not asked that."""
        took_s = self._members[name].window.answered(now_s, key)
        if took_s is None:
            return None
        comparison = self._comparison
        if comparison is not None and key in comparison.took:
            comparison.took[key][name] = took_s
        self._was(name, took_s)
        return took_s

    def gave_up(self, name: str, key: Hashable, now_s: float) -> None:
        """Note that nobody waits for that answer any more."""
        self._members[name].window.gave_up(now_s, key)
        self._was(name, float("inf"))

    def refused(self, name: str, key: Hashable) -> None:
        """Note that a request was refused before it was carried out, which says nothing of latency."""
        self._members[name].window.forget(key)

    def measured(self, name: str, latency_s: float, now_s: float) -> None:
        """Add a latency of a member that was measured elsewhere."""
        self._members[name].window.add(now_s, latency_s)
        self._was(name, latency_s)

    def switch(self, name: str, now_s: float) -> None:
        """Use ``name`` from the next request on, by hand. Raises ``KeyError`` for a member that is not there."""
        if not self._members[name].here:
            raise KeyError(name)
        self._to_profile, self._comparison = [], None
        self._change(name, now_s, "by hand")
        self._came_from = ""

    def step(self, now_s: float) -> None:
        """Decide what time alone brings about: a profile that ends, an answer that is late."""
        if self._to_profile:
            self._step_profile(now_s)
        elif self._comparison is not None:
            self._step_comparison(now_s)
        elif self.current and not self.held:
            self._step_steady(now_s)

    # ── deciding ───────────────────────────────────────────────────────────────────────────────────────────────

    def _was(self, name: str, latency_s: float) -> None:
        member, limit_s = self._members[name], self.bound.limit_s
        if limit_s is not None:
            member.late = member.late + 1 if latency_s > limit_s else 0

    def _step_profile(self, now_s: float) -> None:
        while self._to_profile and now_s >= self._profile_ends_s:
            self._to_profile.pop(0)
            self._profile_ends_s += self.options.profile_s
            if self._profile_ends_s <= now_s:  # nobody asked for a while
                self._profile_ends_s = now_s + self.options.profile_s
        if not self._to_profile:
            for member in self._members.values():
                self._remember(member, now_s)
            best = min((m for m in self._members.values() if m.here), key=lambda m: self._rank(m, now_s), default=None)
            if best is not None and best.name != self.current:
                self._change(best.name, now_s, f"the best of the profile ({self._numbers(best, now_s)})")

    def _step_steady(self, now_s: float) -> None:
        member, limit_s = self._members[self.current], self.bound.limit_s
        if not self.bound.limits:
            return
        pending_s = member.window.oldest_pending_s(now_s)
        overdue = limit_s is not None and pending_s is not None and pending_s > limit_s
        suspicious = member.late + overdue >= _LATE_IN_A_ROW
        if not (suspicious or self._came_from) and now_s < self._judge_at_s:
            return
        self._judge_at_s = now_s + self.options.window_s / _JUDGED_PER_WINDOW
        found = member.window.statistics(now_s)
        missed = self.bound.judge(found) is Standing.MISSED
        if self._came_from:
            self._probation(member, missed or suspicious, now_s)
            return
        if not (missed or suspicious) or found is None:
            return
        rival = self._rival(now_s, whoever=self.stateless)
        if rival is None:
            return
        if not self.stateless and rival.known_s is not None and rival.known_s >= found.median:
            return  # it was no better when it was asked last
        why = (
            self.bound.missed(found)
            or f"{member.late + overdue} requests in a row took more than {1e3 * (limit_s or 0):.0f} ms"
        )
        if self.stateless:
            self._comparison = _Comparison(rival.name)
            self._note(now_s, f"{why}; {rival.name} is asked, too")
        elif now_s - self._since_s >= self.options.least_dwell_s and (missed or member.late > _LATE_IN_A_ROW):
            self._change(rival.name, now_s, why)
            self._came_from = member.name
            rival.window.clear()  # it has to prove itself now

    def _probation(self, member: _Member, bad: bool, now_s: float) -> None:
        """Switch back at once if a change that could not be compared beforehand has proved wrong."""
        before = self._members[self._came_from]
        found, was = member.window.statistics(now_s), before.window.statistics(now_s)
        if found is None or found.answered + found.pending < self.options.pairs:
            return
        if bad and before.here and (was is None or found.median > was.median):
            self._lost(member, now_s)
            self._change(before.name, now_s, f"{member.name} proved no better ({self._numbers(member, now_s)})")
        elif found.answered < self.options.pairs:
            return  # nothing is proved yet
        else:
            self._lost(before, now_s)
        self._came_from = ""

    def _step_comparison(self, now_s: float) -> None:
        comparison = self._comparison
        assert comparison is not None
        mine, rival = self._members[self.current], self._members[comparison.rival]
        pairs = comparison.pairs(now_s, mine.name)
        if len(pairs) < self.options.pairs:
            return
        ours, theirs = self._side([a for a, _ in pairs]), self._side([b for _, b in pairs])
        numbers = (
            f"{rival.name} {1e3 * theirs.mean_s:.1f} ms, {mine.name} {1e3 * ours.mean_s:.1f} ms, {len(pairs)} pairs"
        )
        sooner = len(pairs) >= _ENOUGH * self.options.pairs and theirs.mean_s < ours.mean_s * (1 - self.options.margin)
        beaten = ours.late - theirs.late >= _TELLING or (ours.late == theirs.late and sooner)
        settled = mine.late == 0 and self.bound.judge(mine.window.statistics(now_s)) is not Standing.MISSED
        rested = now_s - self._since_s >= self.options.least_dwell_s and rival.alone_until_s <= now_s
        if beaten and rested and not self.held:
            self._lost(mine, now_s)
            self._change(rival.name, now_s, f"it answers the same requests sooner: {numbers}")
            self._comparison = _Comparison(mine.name)  # until the bound is met, the first answer wins
        elif settled and not beaten:
            self._comparison = None
            self._note(now_s, f"meets the bound: {numbers}")
        elif not beaten and len(pairs) >= _ENOUGH * self.options.pairs:
            self._lost(rival, now_s)
            self._comparison = _Comparison((self._rival(now_s, whoever=True) or rival).name)
        elif len(pairs) >= 2 * _ENOUGH * self.options.pairs:
            self._comparison = _Comparison(rival.name)  # on newer requests

    def _side(self, took: Sequence[float]) -> _Side:
        limit_s = self.bound.limit_s
        return _Side(0 if limit_s is None else sum(t > limit_s for t in took), statistics.fmean(took))

    def _rival(self, now_s: float, *, whoever: bool = False) -> _Member | None:
        """Return the most promising of the others; with ``whoever``, even one to be left alone."""
        others = [m for m in self._members.values() if m.here and m.name != self.current]
        free = [m for m in others if m.alone_until_s <= now_s]
        if not free and whoever:
            return min(others, key=lambda m: m.alone_until_s, default=None)
        return min(free, key=lambda m: self._rank(m, now_s), default=None)

    def _rank(self, member: _Member, now_s: float) -> tuple[int, float, float]:
        found = member.window.statistics(now_s)
        standing = (Standing.MET, Standing.UNKNOWN, Standing.MISSED).index(self.bound.judge(found))
        median_s = member.known_s if found is None else found.median
        return standing, median_s or 0.0, member.alone_until_s

    def _lost(self, member: _Member, now_s: float) -> None:
        forgiven = now_s - member.lost_at_s > self.options.forgive_s
        member.penalty_s = self.options.penalty_s if forgiven else min(2 * member.penalty_s, _MOST_PENALTY_S)
        member.lost_at_s, member.alone_until_s = now_s, now_s + member.penalty_s

    def _change(self, after: str, now_s: float, why: str) -> None:
        self._note(now_s, why, after)
        if self.current:
            self._remember(self._members[self.current], now_s)
        self.current, self._since_s = after, now_s
        if after:
            self._members[after].late = 0

    def _remember(self, member: _Member, now_s: float) -> None:
        found = member.window.statistics(now_s)
        if found is not None:
            member.known_s = found.median

    def _note(self, now_s: float, why: str, after: str | None = None) -> None:
        self.decisions.append(Decision(now_s, self.current, self.current if after is None else after, why))
        self.decided += 1

    def _numbers(self, member: _Member, now_s: float) -> str:
        found = member.window.statistics(now_s)
        return "nothing is known of it" if found is None else f"median {1e3 * found.median:.1f} ms"
