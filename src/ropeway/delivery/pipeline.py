"""The steps that a message takes on its way: each may drop it, with a reason, or hold it for a while."""

from __future__ import annotations

import enum
import time
from collections.abc import Callable
from typing import Final

from ropeway.delivery.outbox import Lost
from ropeway.graph.base import Delivery, Sample

__all__ = ["Drop", "RateLimit", "Reason", "Step", "Tap", "Witness", "build", "lifespan", "tapped", "witnessed"]


class Drop(enum.Enum):
    """The reasons for which a bridge does not pass a message on."""

    RATE = "more often than the rate limit"
    EXPIRED = "older than its lifespan"
    INACTIVE = "nobody asked for it"
    FRAMES = "its frames could not be renamed"


Reason = Drop | Lost
"""Why a message was dropped."""

Step = Callable[[Sample], Sample | Drop | Lost | None]
"""Gives the message that goes on, or the reason for which none does; ``None`` if the step holds it."""

Witness = Callable[[bytes, str], None]
"""Is told the payload of every message, call or goal that passes, and who sent it, where that is known."""

Tap = Callable[[Sample], None]
"""Gets every message of a topic that has crossed."""

_EARLY: Final = 0.2  # of a period: a source with jitter still reaches the rate that was asked for
_LATE: Final = 0.5  # of a period: so much of a late message is made up for by the next


class RateLimit:
    """Passes at most ``rate_hz`` messages a second, evenly.

    The schedule goes on from where a message was due, not from where it came, so that a 60 Hz source limited to
    25 Hz gives 25 Hz, not 20. A pause does not earn a burst.
    """

    def __init__(self, rate_hz: float, clock: Callable[[], float] = time.monotonic) -> None:
        self._period = 1.0 / rate_hz
        self._clock = clock
        self._due = float("-inf")

    def __call__(self, sample: Sample) -> Sample | Drop:
        """Pass or drop one message."""
        now = self._clock()
        early = self._due - now
        if early > _EARLY * self._period:
            return Drop.RATE
        self._due = max(self._due, now - _LATE * self._period) + self._period
        return sample


def lifespan(seconds: float, clock: Callable[[], int] = time.time_ns) -> Step:
    """Make a step that drops messages older than ``seconds`` since the first gateway received them."""
    limit_ns = int(seconds * 1e9)

    def step(sample: Sample) -> Sample | Drop:
        return Drop.EXPIRED if clock() - (sample.sent_ns or sample.stamp_ns) > limit_ns else sample

    return step


def witnessed(witness: Witness | None) -> tuple[Step, ...]:
    """Return a step that passes everything and tells ``witness``, or none where nobody wants to know."""
    if witness is None:
        return ()

    def step(sample: Sample) -> Sample:
        witness(sample.payload, "")
        return sample

    return (step,)


def tapped(tap: Tap) -> Step:
    """Return a step that passes everything, and gives it to ``tap``, too."""

    def step(sample: Sample) -> Sample:
        tap(sample)
        return sample

    return step


def build(delivery: Delivery) -> list[Step]:
    """Make the steps that a route's options ask for, cheapest first."""
    steps: list[Step] = []
    if delivery.lifespan_s is not None:
        steps.append(lifespan(delivery.lifespan_s))
    if delivery.rate_hz is not None:
        steps.append(RateLimit(delivery.rate_hz))
    return steps
