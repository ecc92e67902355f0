"""Has the scheduler of a group decide at the moment when a request is late, and not with the next one."""

from __future__ import annotations

import asyncio
import math
from collections.abc import Callable

from ropeway.group.chooser import Chooser

__all__ = ["LateWatch"]


class LateWatch:
    """Wakes the scheduler once a request to the member in use has waited as long as the bound allows.

    One timer serves all requests: who has sent one looks at ``idle``, and calls ``begin`` if it is. ``late`` is called
    after each decision that a timer has brought about.
    """

    def __init__(self, group: Chooser, late: Callable[[], None] = lambda: None) -> None:
        self._group, self._late = group, late
        self._timer: asyncio.TimerHandle | None = None
        self.idle = group.scheduler.bound.limit_s is not None
        """Whether no timer runs, and one is of use: without a bound nothing is late."""

    def begin(self) -> None:
        """Watch what was sent until all of it is answered or late."""
        self._wait(self._group.now())

    def close(self) -> None:
        """Watch no longer."""
        self.idle = False
        if self._timer is not None:
            self._timer.cancel()

    def _wait(self, now_s: float) -> None:
        at_s = self._group.scheduler.late_at_s(now_s)
        self.idle = math.isinf(at_s)
        if not self.idle:
            self._timer = asyncio.get_running_loop().call_later(max(0.0, at_s - now_s), self._due)

    def _due(self) -> None:
        group = self._group
        now_s, before = group.now(), group.scheduler.decided
        group.scheduler.step(now_s)
        if group.scheduler.decided != before:
            group.tell()
            self._late()
        self._wait(now_s)
