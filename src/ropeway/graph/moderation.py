"""Says when a thread that wakes for messages should rest before it waits for more, as drivers of network cards do.

A message that comes alone has to wake a thread, and that costs more than all else that is done for it. At some
thousands of messages a second the next ones come within moments: then the thread sleeps for ``REST_S`` and takes what
has come together. So a message waits at most that much longer, and only where so many come.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from typing import Final

__all__ = ["REST_S", "Moderation"]

REST_S: Final = 0.00019
"""How long to sleep: with the slack of the system's timers (50 us) no message is held for more than 250 us."""

_LOOK_SAMPLES: Final = 32  # so few that a look is due within some milliseconds of a change, at rates that matter
_BUSY_HZ: Final = 6000  # with fewer, a rest would join hardly two messages, and its end is one more wake-up


class Moderation:
    """Decides by the rate of the last messages whether to rest: ``rests`` is that decision.

    ``samples`` have come already. Call ``look`` once so many have come as ``next_look`` says; before, nothing is to do.
    """

    __slots__ = ("_clock", "_looked_ns", "_samples", "next_look", "rests")

    def __init__(self, samples: int = 0, *, clock: Callable[[], int] = time.monotonic_ns) -> None:
        self.rests = False
        self.next_look = samples + _LOOK_SAMPLES
        self._clock = clock
        self._samples, self._looked_ns = samples, clock()

    def look(self, samples: int) -> None:
        """Decide anew: ``samples`` have come so far."""
        now_ns = self._clock()
        self.rests = (samples - self._samples) * 1_000_000_000 > _BUSY_HZ * (now_ns - self._looked_ns)
        self._samples, self._looked_ns = samples, now_ns
        self.next_look = samples + _LOOK_SAMPLES
