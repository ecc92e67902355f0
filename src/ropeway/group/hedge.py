"""Says which members of a group get a request, and when a second one does. Sans-I/O."""

from __future__ import annotations

import enum
from typing import Final

from ropeway.group.scheduler import Scheduler

__all__ = ["HedgeDelay", "Policy"]

_PERCENT: Final = 95.0
"""A second member is asked once the first takes longer than so many percent of its answers do: 5 % more requests."""

_SLACK: Final = 0.1
_LEAST_SLACK_S: Final = 0.001
"""The least slack added to that: steady machines would otherwise be hedged by chance."""

_UNKNOWN_S: Final = 0.1
"""When the second is asked while nothing is known of the first, and no bound says what is late."""

_GOOD_FOR_S: Final = 0.05
"""How long a delay is used before it is found anew: sorting a window costs more than sending a message."""


class Policy(enum.Enum):
    """Says which members get a request."""

    ONE = "one"
    HEDGE = "hedge"
    ALL = "all"


class HedgeDelay:
    """Tells how long the first member has for its answer before a second is asked, too."""

    def __init__(self, scheduler: Scheduler) -> None:
        self._scheduler = scheduler
        self._found: tuple[float, str, float] | None = None  # until when it is good, of whom, and the delay

    def seconds(self, now_s: float) -> float:
        """Return the delay for the member in use."""
        current = self._scheduler.current
        if self._found is None or self._found[0] <= now_s or self._found[1] != current:
            self._found = now_s + _GOOD_FOR_S, current, self._find(current, now_s)
        return self._found[2]

    def _find(self, current: str, now_s: float) -> float:
        found = self._scheduler.window(current).statistics(now_s) if current else None
        if found is not None and found.answered:
            usual_s = found.percentile(_PERCENT)
            return usual_s + max(_SLACK * usual_s, _LEAST_SLACK_S)
        return self._scheduler.bound.limit_s or _UNKNOWN_S
