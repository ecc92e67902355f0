"""When a connection may send: not while the operating system is full, and not beyond the window."""

from __future__ import annotations

import asyncio
import time
from collections.abc import Callable
from typing import Any, Final

from ropeway.link.pace import Pace
from ropeway.link.window import Window

__all__ = ["Flow"]

_SHORTEST_LOOK_S: Final = 0.001
_LONGEST_LOOK_S: Final = 0.05
_LATE: Final = 0.3  # of the time: a look that came so late says nothing of the link
_LATE_LOOKS: Final = 3  # in a row: then more must be on the way while we do other things
_FASTER: Final = 1.25  # a wider window that brings so much more shows that the link has room


class Flow:
    """The flow of one connection. ``free`` tells whether to send; ``on_free`` is called when it is true again."""

    def __init__(self, on_free: Callable[[], None]) -> None:
        self.pace = Pace()
        self.window: Window | None = None
        self.free = True
        self._on_free = on_free
        self._full_at: float | None = None  # since when the operating system takes no more
        self._full_bytes = 0
        self._waits_since: float | None = None  # since when the window is used up
        self._waits_bytes = 0
        self._look: asyncio.TimerHandle | None = None
        self._look_due = 0.0
        self._late_looks = 0
        self._rate_when_empty = 0.0

    def open(self, sock: Any) -> None:
        """The connection stands on this socket."""
        self.window = Window(sock)

    def close(self) -> None:
        """Nothing is sent any more."""
        self.window = None
        if self._look is not None:
            self._look.cancel()

    def sent(self) -> None:
        """Something was handed to the transport: is the window used up?"""
        window = self.window
        if self.free and window is not None and window.limit is not None:
            outstanding = window.outstanding()
            if outstanding is not None and outstanding >= window.limit:
                self.free = False
                self._waits_since, self._waits_bytes = time.monotonic(), outstanding
                self._arm(outstanding, window.limit)

    def full(self, left_bytes: int) -> None:
        """The operating system did not take ``left_bytes``."""
        self.free = False
        self._full_at, self._full_bytes = time.monotonic(), left_bytes

    def drained(self) -> None:
        """The operating system took everything."""
        since, self._full_at = self._full_at, None
        if since is not None and self._waits_since is None and self.window is not None:
            self._learn(self._full_bytes, time.monotonic() - since, self.window.outstanding() or 0)
        self._go_on()

    def _go_on(self) -> None:
        if self._full_at is None and self._waits_since is None:
            self.free = True
            self._on_free()

    def _arm(self, outstanding: int, limit: int) -> None:
        """Look again when half of the window should be free."""
        pace = self.pace.bytes_per_s
        seconds = _SHORTEST_LOOK_S if pace is None else min((outstanding - limit // 2) / pace, _LONGEST_LOOK_S)
        loop = asyncio.get_running_loop()
        self._look_due = loop.time() + max(seconds, _SHORTEST_LOOK_S)
        self._look = loop.call_at(self._look_due, self._look_again)

    def _look_again(self) -> None:
        self._look = None
        window, since = self.window, self._waits_since
        if window is None or since is None:
            return
        outstanding = window.outstanding() or 0
        if window.limit is not None and outstanding > window.limit // 2:
            self._arm(outstanding, window.limit)
            return
        self._waits_since = None
        late_s = asyncio.get_running_loop().time() - self._look_due
        self._learn(self._waits_bytes - outstanding, time.monotonic() - since, outstanding, late_s)
        self._go_on()

    def _learn(self, carried_bytes: int, seconds: float, outstanding: int, late_s: float = 0.0) -> None:
        """Take the measure of the link, if it was busy all the time until we looked."""
        window, pace = self.window, self.pace
        if window is None or seconds <= 0:
            return
        if outstanding <= window.late_bytes:
            rate, before = carried_bytes / seconds, self._rate_when_empty
            self._rate_when_empty = rate
            late = late_s > _LATE * seconds
            self._late_looks = self._late_looks + 1 if late else 0
            if (late and self._late_looks >= _LATE_LOOKS) or (pace.bytes_per_s is None and rate > _FASTER * before):
                window.grow()
                return
            if late:
                return
        pace.carried(carried_bytes, seconds)
        if pace.bytes_per_s is not None:
            window.fit(pace.bytes_per_s)
