"""Defines what the parts of a group need of it."""

from __future__ import annotations

from collections import Counter
from typing import Protocol

from ropeway.graph.base import Undelivered
from ropeway.group.scheduler import Scheduler

__all__ = ["Chooser"]


class Chooser(Protocol):
    """Says who is asked, and keeps what is counted."""

    name: str
    scheduler: Scheduler
    stateless: bool
    drops: Counter[tuple[str, Undelivered]]

    def now(self) -> float:
        """Return the time of the steady clock that latencies are measured with."""

    def alone(self, now_s: float) -> str:
        """Return the member that gets the next request alone; ``""`` where something is to be decided first."""

    def targets(self) -> tuple[str, ...]:
        """Return the members that get the next request at once."""

    def ranked(self) -> list[str]:
        """Return the members that are there, the one in use first, then the most promising."""

    def second(self) -> str:
        """Return who is asked if the first is late, ``""`` for nobody."""

    def hedge_after_s(self) -> float:
        """Return how long the first has before the second is asked, too."""

    def tell(self) -> None:
        """Log what was decided."""

    def closed(self, part: object) -> None:
        """Forget a part that was closed."""
