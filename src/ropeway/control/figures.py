"""Writes figures for people, the same on the command line and in the dashboard."""

from __future__ import annotations

__all__ = ["duration", "shown_number"]


def shown_number(value: float | None, factor: float = 1.0) -> str:
    """Return a number with three digits or so; ``-`` for what is not known."""
    if value is None:
        return "-"
    shown = value * factor
    return f"{shown:.0f}" if shown >= 100 else f"{shown:.1f}" if shown >= 1 or not shown else f"{shown:.2g}"


def duration(seconds: float) -> str:
    """Return a time span in its two largest units."""
    whole = max(int(seconds), 0)
    days, hours, minutes = whole // 86400, whole // 3600 % 24, whole // 60 % 60
    if days:
        return f"{days} d {hours} h"
    if hours:
        return f"{hours} h {minutes} min"
    return f"{minutes} min {whole % 60} s" if minutes else f"{whole} s"
