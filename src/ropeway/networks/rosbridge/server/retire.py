"""Names a withdrawn topic whose time of grace is over; it waits for its turn among the operations of its client."""

from __future__ import annotations

from dataclasses import dataclass

__all__ = ["Retire"]


@dataclass(frozen=True, slots=True)
class Retire:
    """The time that a withdrawn topic was kept for its client is over."""

    topic: str
    op: str = "unadvertise"
