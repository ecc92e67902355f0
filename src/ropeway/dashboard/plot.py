"""Draws the last values of a few figures over each other."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from typing import Any, Final

from ropeway.control.figures import shown_number
from ropeway.dashboard.svg import Drawing

__all__ = ["COLOURS", "draw_plot", "numbers_of"]

COLOURS: Final = ("#1d4ed8", "#b91c1c", "#15803d", "#b45309", "#7e22ce", "#0e7490", "#be185d", "#4d7c0f")
"""The colours of lines, and so the most of them."""

_LEFT: Final = 46.0
_HEIGHT: Final = 180.0


def draw_plot(lines: Mapping[str, Sequence[float]], width: float, kept: int) -> str:
    """Return the lines as SVG; ``kept`` values are as wide as the plot, the newest is at the right."""
    drawing = Drawing(width)
    values = [value for line in lines.values() for value in line]
    low, high = min(values, default=0.0), max(values, default=1.0)
    if low == high:
        low, high = low - 1.0, high + 1.0
    right = width - 4.0
    for share in (0.0, 0.5, 1.0):
        y = 8.0 + (1 - share) * _HEIGHT
        drawing.curve([(_LEFT, y), (right, y)], colour="#94a3b855")
        drawing.text(0, y + 4, _axis(low + share * (high - low)), size=10)
    for colour, (name, line) in zip(COLOURS, lines.items(), strict=False):
        step = (right - _LEFT) / max(kept - 1, 1)
        first = right - step * (len(line) - 1)
        places = [
            (first + step * index, 8.0 + (high - value) / (high - low) * _HEIGHT) for index, value in enumerate(line)
        ]
        drawing.curve(places, colour=colour)
        y = drawing.height + (24.0 if drawing.height < _HEIGHT + 20 else 15.0)
        drawing.text(_LEFT, y, f"{name}: {_axis(line[-1]) if line else '-'}", size=12, colour=colour, bold=True)
    return drawing.written()


def numbers_of(value: Any, path: str = "") -> Iterator[tuple[str, float]]:
    """Yield the numbers of a message by their paths, as in ``pose.position.x`` or ``ranges[3]``."""
    if isinstance(value, int | float):
        yield path, float(value)
    elif isinstance(value, dict):
        for key, item in value.items():
            yield from numbers_of(item, f"{path}.{key}" if path else str(key))
    elif isinstance(value, list):
        for index, item in enumerate(value):
            yield from numbers_of(item, f"{path}[{index}]")


def _axis(value: float) -> str:
    return f"-{shown_number(-value)}" if value < 0 else shown_number(value)
