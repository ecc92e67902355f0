"""Decides which member of a group gets the requests. Sans-I/O: the gateway and the simulator use the same object.

The best member is found once, at the start, by asking all in turns for a moment (``profile_run``). From then on
nothing is tried without a reason: the member in use must miss the bound, or be gone. Latencies of compressed video rise
and fall together on all machines, so windows of different times say little; what is compared is *pairs*, the same
request to two members (``comparison``). From the first request that is late on, the two best get each request and the
first answer wins, which is never later than either alone would have been. That needs requests that may be carried out
twice (``stateless``); where they may not, another is used only if it was better when it was asked last, or nobody
knows, and if it proves worse the way back is at once.

A member that lost a comparison is left alone for a time that doubles with each loss, so that one that flaps is not
followed.
"""

from __future__ import annotations

import enum
from collections import deque
from collections.abc import Hashable, Sequence
from dataclasses import dataclass
from typing import Any, Final

from ropeway.group.bound import LatencyBound, Standing
from ropeway.group.comparison import ENOUGH, Comparison
from ropeway.group.latency import LatencyWindow
from ropeway.group.options import Options
from ropeway.group.profile_run import ProfileRun
from ropeway.group.replica import Replica

__all__ = ["Decision", "Options", "Phase", "Scheduler"]

_LATE_IN_A_ROW: Final = 2  # requests above the limit, one after the other, that count as a missed bound
_CLEARLY: Final = 1.5  # times the latency of the one before: a change that is worse than that is wrong at once
_JUDGED_PER_WINDOW: Final = 50  # what two requests in a row do not show, shows in a window, and not sooner
_JUST_S: Final = 1e-4  # after its limit a request is late; a timer that is set to the limit itself may come sooner
_MOST_DECISIONS: Final = 256
_NEVER_S: Final = float("-inf")  # before any time of the clock
_MOST_GONE: Final = 64  # members that are not there, whose penalties are remembered


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


class Scheduler:
    """Chooses among ``names``; see the module.

    Tell it when members come and go (``came``, ``left``), what was sent to whom (``asked``) and what came back
    (``answered``), or latencies that were measured elsewhere (``measured``); ask ``targets`` for who gets the next
    request. ``first`` is used before anything is known, if it is there. All times are of one steady clock.
    ``decisions`` keeps the last ones, with their reasons.
    """

    def __init__(
        self,
        names: Sequence[str],
        bound: LatencyBound = LatencyBound(),  # noqa: B008 - frozen
        *,
        stateless: bool = False,
        first: str = "",
        options: Options = Options(),  # noqa: B008 - frozen
    ) -> None:
        self.bound, self.stateless, self.options = bound, stateless, options
        self._limit_s = bound.limit_s
        self.current = ""
        self.held = False  # by hand: nothing is switched
        self.decisions: deque[Decision] = deque(maxlen=_MOST_DECISIONS)
        self.decided = 0  # in all
        self._members = {name: Replica(name, LatencyWindow(options.window_s)) for name in names}
        self._since_s = _NEVER_S
        self._profile: ProfileRun | None = None
        self._profiled = False
        self._first = first
        self._comparison: Comparison | None = None
        self._judge_at_s = self._pause_until_s = _NEVER_S
        self._ranked: tuple[float, list[str]] | None = None  # until when it is good
        self._came_from = ""  # where the last change came from, while it is on probation
        self._was_s = 0.0  # what that one took just before: the weather is the same
        self._quiet_until_s = _NEVER_S  # nothing is to be decided before, unless something happens

    # ── what is ────────────────────────────────────────────────────────────────────────────────────────────────

    @property
    def phase(self) -> Phase:
        """Return what it is doing."""
        if self._profile is not None:
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

    def alone(self, now_s: float) -> str:
        """Return who gets the next request alone; ``""`` where ``targets`` has to be asked, as something is due."""
        return self.current if now_s < self._quiet_until_s else ""

    def targets(self, now_s: float) -> tuple[str, ...]:
        """Return who gets the next request; more than one only where requests may be carried out twice."""
        if now_s < self._quiet_until_s:
            return (self.current,)
        self.step(now_s)
        profiled = "" if self._profile is None else self._profile.next(now_s)
        if profiled:
            return (profiled,)
        if self._comparison is not None and self.stateless:
            return (self.current, self._comparison.rival)
        return (self.current,) if self.current else ()

    def ranked(self, now_s: float) -> list[str]:
        """Return the members that are there, the one in use first, then the most promising."""
        if self._ranked is None or now_s >= self._ranked[0]:
            others = [m for m in self._members.values() if m.here and m.name != self.current]
            others.sort(key=lambda m: m.rank(self.bound, now_s))
            ranked = [*([self.current] if self.current else []), *(m.name for m in others)]
            self._ranked = now_s + self.options.window_s / _JUDGED_PER_WINDOW, ranked
        return self._ranked[1]

    def late_at_s(self, now_s: float) -> float:
        """Return when a request to the member in use is late next, unless it is answered; infinity without one.

        ``step`` is due then: nothing else tells that nothing comes.
        """
        if self._limit_s is None or not self.current:
            return float("inf")
        return self._members[self.current].window.next_late_s(now_s, self._limit_s + _JUST_S)

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
                    "result_s": None if (ends := m.results.statistics(now_s)) is None else ends.as_json(),
                    "in_flight": m.window.in_flight,
                    "alone_for_s": round(max(0.0, m.alone_until_s - now_s), 3),
                }
                for m in self._members.values()
                for found in (m.window.statistics(now_s),)
            },
            "decisions": [str(decision) for decision in list(self.decisions)[-8:]],
        }

    # ── what happens ───────────────────────────────────────────────────────────────────────────────────────────

    def add(self, name: str) -> None:
        """Learn of a member, which need not be there yet; of those that are gone the first are forgotten."""
        if name in self._members:
            return
        gone = [other for other, member in self._members.items() if not member.here]
        for other in gone[: max(0, len(gone) - _MOST_GONE + 1)]:
            del self._members[other]
        self._members[name] = Replica(name, LatencyWindow(self.options.window_s))

    def came(self, name: str, now_s: float) -> None:
        """Note that a member is there."""
        member = self._members[name]
        if member.here:
            return
        member.here, member.late, member.known_s = True, 0, None
        member.window.clear()
        self._look_again()
        if not self.current:
            self._change(name, now_s, "the first that is there")
        elif name == self._first and not self._profiled:
            self._change(name, now_s, "the policy begins with it")
        if self._profile is not None:
            self._profile.joined(name)

    def left(self, name: str, now_s: float) -> None:
        """Remove a member that is gone: the next request goes to the most promising of the others."""
        member = self._members[name]
        if not member.here:
            return
        member.here = False
        member.window.clear()
        self._look_again()
        if self._profile is not None:
            self._profile.left(name)
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
        self._look_again()
        here = self.here
        self._profile = ProfileRun(here, now_s, self.options, self._limit_s) if len(here) > 1 else None

    def asked(self, names: Sequence[str], key: Hashable, now_s: float) -> None:
        """Note that a request was sent to ``names``."""
        if not self._profiled and self.bound.limits:
            self.profile(now_s)
        for name in names:
            self._members[name].window.asked(now_s, key)
            if self._profile is not None:
                self._profile.asked(name, now_s)
        if self._comparison is not None and len(names) > 1:
            self._comparison.asked(key, now_s)

    def answered(self, name: str, key: Hashable, now_s: float) -> float | None:
        """Note a member's answer; return how long it took, ``None`` if the member was not asked that."""
        member = self._members[name]
        took_s = member.window.answered(now_s, key)
        if took_s is None:
            return None
        if self._comparison is not None:
            self._comparison.answered(key, name, took_s)
        if self._profile is not None:
            self._profile.answered(name)
        if member.was(took_s, self._limit_s):
            self._quiet_until_s = _NEVER_S
        return took_s

    def gave_up(self, name: str, key: Hashable, now_s: float) -> None:
        """Note that nobody waits for that answer any more."""
        member = self._members[name]
        member.window.gave_up(now_s, key)
        if self._profile is not None:
            self._profile.answered(name)
        if member.was(float("inf"), self._limit_s):
            self._quiet_until_s = _NEVER_S

    def refused(self, name: str, key: Hashable) -> None:
        """Note that a request was refused before it was carried out, which says nothing of latency."""
        self._members[name].window.forget(key)

    def unheard(self) -> None:
        """Note that answers are not read for the time being: a profile that is under way is taken later."""
        if self._profile is not None:
            self._profile, self._profiled = None, False

    def measured(self, name: str, latency_s: float, now_s: float) -> None:
        """Add a latency of a member that was measured elsewhere."""
        self._members[name].window.add(now_s, latency_s)
        if self._members[name].was(latency_s, self._limit_s):
            self._quiet_until_s = _NEVER_S

    def finished(self, name: str, took_s: float, now_s: float) -> None:
        """Note how long a goal of a member took until it succeeded."""
        if name in self._members:
            self._members[name].results.add(now_s, took_s)
            if self.options.judge_results:
                self.measured(name, took_s, now_s)

    def switch(self, name: str, now_s: float, why: str = "by hand") -> None:
        """Use ``name`` from the next request on, by hand. Raises ``KeyError`` for a member that is not there."""
        if not self._members[name].here:
            raise KeyError(name)
        self._profile = self._comparison = None
        self._change(name, now_s, why)
        self._came_from = ""

    def step(self, now_s: float) -> None:
        """Decide what time alone brings about: a profile that ends, an answer that is late."""
        if self._profile is not None:
            self._step_profile(self._profile, now_s)
        elif self._comparison is not None:
            self._step_comparison(self._comparison, now_s)
        elif self.current and not self.held:
            self._step_steady(now_s)
            self._be_quiet(now_s)

    def _be_quiet(self, now_s: float) -> None:
        """Find out until when there is nothing to decide, unless an answer comes late, or a member comes or goes."""
        if self._comparison is not None or self._came_from:
            return
        if not self.bound.limits:
            self._quiet_until_s = float("inf")
            return
        until_s = max(self._judge_at_s, self._pause_until_s)
        if self._limit_s is not None:  # what was sent, and what will be, can be late no sooner
            member = self._members[self.current]
            until_s = min(until_s, min(now_s, member.window.waits_since_s()) + self._limit_s)
            if member.late:
                return
        self._quiet_until_s = until_s

    def _look_again(self) -> None:
        """Decide with the next request: something has happened."""
        self._ranked = None
        self._quiet_until_s = _NEVER_S

    # ── deciding ───────────────────────────────────────────────────────────────────────────────────────────────

    def _step_profile(self, profile: ProfileRun, now_s: float) -> None:
        if not profile.over(now_s):
            return
        here = [m for m in self._members.values() if m.here]
        missed = here and all(self.bound.judge(m.window.statistics(now_s)) is Standing.MISSED for m in here)
        if missed and not self.stateless and not profile.longer:
            profile.go_on(now_s)  # which of them is least bad a few answers do not tell, and nobody is left waiting
            return
        self._profile, self._pause_until_s = None, now_s + self.options.pause_s
        for member in self._members.values():
            member.remember(now_s)
        if missed:  # what a bound is about is what is slow, more than what is usual
            steady = min(here, key=lambda m: m.worst_s)
            here = [m for m in here if not m.is_worse_at_worst(steady, self._limit_s)]
        best = min(here, key=lambda m: m.rank(self.bound, now_s), default=None)
        if best is not None and best.name != self.current and not self.held:
            self._change(best.name, now_s, f"the best of the profile ({best.numbers(now_s)})")
        self._since_s = _NEVER_S  # a profile is short, and may be corrected

    def _step_steady(self, now_s: float) -> None:
        if not self.bound.limits or now_s < self._pause_until_s:
            return
        member = self._members[self.current]
        late = member.late_in_a_row(now_s, self._limit_s)
        suspicious = late >= (1 if self.stateless else _LATE_IN_A_ROW)
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
        limit_s = self._limit_s or 0.0
        why = self.bound.missed(found) or f"{late} in a row took more than {1e3 * limit_s:.0f} ms"
        rested = now_s - self._since_s >= self.options.least_dwell_s
        if self.stateless:
            silent = rested and member.fell_silent(now_s, limit_s, found.median)
            if silent and rival.was_in_time(now_s, limit_s, self.options):
                since_s = self._since_s
                self._change(rival.name, now_s, f"{member.name} has not answered for a while: {why}")
                self._since_s = since_s  # the comparison that begins may take it back at once
                self._comparison = Comparison(member.name)
                return
            self._comparison = Comparison(rival.name, hiccup=not missed)
            self._note(now_s, f"{why}; {rival.name} is asked, too")
        elif rested:
            known_s = rival.may_take_s(now_s, self.options)
            enough = found.answered + found.pending >= ENOUGH * self.options.pairs
            if known_s is not None:
                known_s += member.risen_s(found.mean, rival)
            if known_s is None or (
                enough
                and not rival.is_worse_at_worst(member, self._limit_s)
                and known_s < found.mean * (1 - self.options.margin)
            ):
                self._was_s = member.window.recent_s(ENOUGH * self.options.pairs) or found.mean
                self._change(rival.name, now_s, why)
                self._came_from = member.name
                rival.window.clear()  # it has to prove itself now

    def _probation(self, member: Replica, bad: bool, now_s: float) -> None:
        """Switch back at once if a change that could not be compared beforehand has proved wrong."""
        before = self._members[self._came_from]
        found = member.window.statistics(now_s)
        if found is None or found.answered + found.pending < self.options.pairs:
            return
        was_s = self._was_s
        enough = found.answered >= ENOUGH * self.options.pairs
        if not enough and found.mean <= _CLEARLY * was_s:
            return  # a few answers prove only what is far worse
        if bad and before.here and found.mean - found.error_s > was_s:
            member.lost(now_s, self.options)
            self._change(before.name, now_s, f"{member.name} proved no better ({member.numbers(now_s)})")
        elif found.answered < self.options.pairs:
            return  # nothing is proved yet
        else:
            before.lost(now_s, self.options)
        self._came_from = ""

    def _step_comparison(self, comparison: Comparison, now_s: float) -> None:
        mine, rival = self._members[self.current], self._members[comparison.rival]
        late = mine.late_in_a_row(now_s, self._limit_s)
        evidence = comparison.judge(mine.name, late, self._limit_s, now_s, self.options)
        if not evidence.pairs:
            return
        settled = late == 0 and self.bound.judge(mine.window.statistics(now_s)) is not Standing.MISSED
        rested = now_s - self._since_s >= self.options.least_dwell_s and rival.alone_until_s <= now_s
        if evidence.beaten and rested and not self.held:
            mine.lost(now_s, self.options)
            self._change(rival.name, now_s, f"it answers the same requests sooner: {evidence.numbers}")
            self._comparison = Comparison(mine.name)  # until the bound is met, the first answer wins
        elif settled and evidence.sound and not evidence.beaten:
            self._comparison = None
            if evidence.behind:
                rival.lost(now_s, self.options)
            self._note(now_s, f"meets the bound: {evidence.numbers}")
        elif not evidence.beaten and evidence.pairs >= ENOUGH * self.options.pairs:
            rival.lost(now_s, self.options)
            self._comparison = Comparison((self._rival(now_s, whoever=True) or rival).name)
        elif evidence.pairs >= 2 * ENOUGH * self.options.pairs:
            self._comparison = Comparison(rival.name)  # on newer requests

    def _rival(self, now_s: float, *, whoever: bool = False) -> Replica | None:
        """Return the most promising of the others; with ``whoever``, even one to be left alone."""
        others = [m for m in self._members.values() if m.here and m.name != self.current]
        free = [m for m in others if m.alone_until_s <= now_s]
        if not free and whoever:
            return min(others, key=lambda m: m.alone_until_s, default=None)
        return min(free, key=lambda m: m.rank(self.bound, now_s), default=None)

    def _change(self, after: str, now_s: float, why: str) -> None:
        self._note(now_s, why, after)
        self._look_again()
        if self.current:
            self._members[self.current].remember(now_s)
        self.current, self._since_s = after, now_s
        if after:
            self._members[after].late = 0

    def _note(self, now_s: float, why: str, after: str | None = None) -> None:
        self.decisions.append(Decision(now_s, self.current, self.current if after is None else after, why))
        self.decided += 1
