"""Compares two members on the same requests. Sans-I/O."""

from __future__ import annotations

import statistics
from collections.abc import Hashable, Iterable
from dataclasses import dataclass, field
from typing import Final, NamedTuple

from ropeway.group.options import Options

__all__ = ["ENOUGH", "Comparison", "Evidence"]

ENOUGH: Final = 4
"""So many times the pairs that may show one side late are needed to compare means, or to give a rival up."""

_TELLING: Final = 2  # late requests more than the rival's, of as many: one more may be chance


class _Side(NamedTuple):
    late: int
    in_time: int  # answered, and not late
    mean_s: float


class Evidence(NamedTuple):
    """Summarises what the pairs of a comparison say of the rival."""

    pairs: int
    beaten: bool  # the one in use, by the rival
    behind: bool  # the rival, by the one in use
    sound: bool  # the one in use has answered in time what both were asked
    numbers: str


@dataclass(slots=True, eq=False)
class Comparison:
    """Requests that two members had at the same time: how long each took.

    With ``hiccup``, what started it was no window that misses the bound but a request or two, and one good answer
    ends it.
    """

    rival: str
    hiccup: bool = False
    _asked: dict[Hashable, float] = field(default_factory=dict)
    _took: dict[Hashable, dict[str, float]] = field(default_factory=dict)

    def asked(self, key: Hashable, now_s: float) -> None:
        """Note a request that both got."""
        self._asked[key], self._took[key] = now_s, {}

    def answered(self, key: Hashable, name: str, took_s: float) -> None:
        """Note how long one of them took for it."""
        took = self._took.get(key)
        if took is not None:
            took[name] = took_s

    def judge(self, mine: str, late_in_a_row: int, limit_s: float | None, now_s: float, options: Options) -> Evidence:
        """Return what is known so far; ``late_in_a_row`` of the one in use counts what it alone was asked, too.

        Two requests in a row that are late, and a rival in time for what both were asked, are enough. Else the rival
        must be late twice less often, or sooner by the margin in the mean of many.
        """
        keys = [key for key, took in self._took.items() if took]
        ours, theirs = (self._side(name, keys, limit_s, now_s) for name in (mine, self.rival))
        many = len(keys) >= ENOUGH * options.pairs
        quick = late_in_a_row >= _TELLING and theirs.in_time > 0 and theirs.late == 0
        clear = len(keys) >= options.pairs and ours.late - theirs.late >= _TELLING
        sooner = many and ours.late == theirs.late and theirs.mean_s < ours.mean_s * (1 - options.margin)
        numbers = (
            f"{self.rival} {1e3 * theirs.mean_s:.1f} ms, {mine} {1e3 * ours.mean_s:.1f} ms, {len(keys)} pairs, "
            f"late {theirs.late} and {ours.late}"
        )
        sound = ours.in_time >= (1 if self.hiccup else options.pairs)
        behind = theirs.late - ours.late >= _TELLING
        return Evidence(len(keys), quick or clear or sooner, behind, sound, numbers)

    def _side(self, name: str, keys: Iterable[Hashable], limit_s: float | None, now_s: float) -> _Side:
        """Return how a side did; an answer that is missing takes at least until now."""
        answered = [took for key in keys if (took := self._took[key].get(name)) is not None]
        ages = [now_s - self._asked[key] for key in keys if name not in self._took[key]]
        both = answered + ages
        if limit_s is None:
            return _Side(0, len(answered), statistics.fmean(both) if both else 0.0)
        in_time = sum(took <= limit_s for took in answered)
        return _Side(sum(took > limit_s for took in both), in_time, statistics.fmean(both) if both else 0.0)
