"""Writes figures for people."""

from __future__ import annotations

import time
from typing import Final

from ropeway.control.figures import shown_number
from ropeway.dashboard.answers import RouteRow

__all__ = ["at", "fitted", "rate_of"]


_LAST_S: Final = 4e9


def rate_of(route: RouteRow) -> str:
    """Write the rate of a route; where nothing crosses, its state."""
    return f"{shown_number(route.rate_hz)} Hz" if route.state == "active" and route.rate_hz is not None else route.state


def fitted(text: str, room: int) -> str:
    """Return a text in at most ``room`` characters; what is left out is in its middle."""
    if len(text) <= max(room, 3):
        return text
    kept = max(room, 3) - 1
    return f"{text[: kept - kept // 2]}…{text[len(text) - kept // 2 :]}"


def at(seconds: float) -> str:
    """Write a time of the day; a clock that is far off is shown as one at the border."""
    return time.strftime("%H:%M:%S", time.localtime(min(max(seconds, 0.0), _LAST_S)))
