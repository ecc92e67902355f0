"""Makes drawings. They are built as a tree and written by ``ElementTree``, so that no name can become markup."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Final
from xml.etree import ElementTree as Tree

__all__ = ["Drawing", "colour_of", "points"]

_COLOURS: Final = {"good": "#15803d", "bad": "#b91c1c", "idle": "#64748b", "other": "#b45309"}
_STATES: Final = {
    "active": "good",
    "connected": "good",
    "failed": "bad",
    "waiting to retry": "bad",
    "closed": "bad",
    "gone": "bad",
    "idle": "idle",
    "paused": "idle",
}
_FORBIDDEN: Final = dict.fromkeys((*range(9), 11, 12, *range(14, 32), 65534, 65535, *range(55296, 57344)), "�")


def colour_of(state: str) -> str:
    """Return the colour of a state: green where all is well, grey where nothing is to be done, red, else amber."""
    return _COLOURS[_STATES.get(state, "other")]


def points(values: Iterable[float], width: float, height: float) -> str:
    """Return the points of a line through values, the newest at the right, zero at the bottom."""
    shown = list(values)
    top = max(shown, default=0.0) or 1.0
    step = width / max(len(shown) - 1, 1)
    return " ".join(f"{index * step:.1f},{height - value / top * height:.1f}" for index, value in enumerate(shown))


class Drawing:
    """A drawing of boxes, lines and texts, in units of its own."""

    def __init__(self, width: float) -> None:
        self.width = width
        self.height = 0.0
        self._root = Tree.Element("svg", {"xmlns": "http://www.w3.org/2000/svg", "role": "img"})

    def box(self, x: float, y: float, width: float, height: float, *, colour: str, href: str = "") -> None:
        """Draw a box; ``href`` is a path of ours that it leads to."""
        place = {"x": f"{x:.1f}", "y": f"{y:.1f}", "width": f"{width:.1f}", "height": f"{height:.1f}", "rx": "8"}
        parent = Tree.SubElement(self._root, "a", {"href": href}) if href else self._root
        Tree.SubElement(parent, "rect", {**place, "fill": colour, "fill-opacity": "0.1", "stroke": colour})
        self.height = max(self.height, y + height)

    def line(self, x1: float, y1: float, x2: float, y2: float, *, colour: str, title: str = "") -> None:
        """Draw an arrow from one place to another; ``title`` appears where the mouse rests."""
        place = {"x1": f"{x1:.1f}", "y1": f"{y1:.1f}", "x2": f"{x2:.1f}", "y2": f"{y2:.1f}"}
        drawn = Tree.SubElement(self._root, "line", {**place, "stroke": colour, "stroke-width": "2"})
        if title:
            Tree.SubElement(drawn, "title").text = title.translate(_FORBIDDEN)
        side = -6 if x2 > x1 else 6
        head = f"{x2:.1f},{y2:.1f} {x2 + side:.1f},{y2 - 4:.1f} {x2 + side:.1f},{y2 + 4:.1f}"
        Tree.SubElement(self._root, "polygon", {"points": head, "fill": colour})
        self.height = max(self.height, y1, y2)

    def curve(self, places: Iterable[tuple[float, float]], *, colour: str) -> None:
        """Draw a line through places."""
        joined = " ".join(f"{x:.1f},{y:.1f}" for x, y in places)
        Tree.SubElement(
            self._root, "polyline", {"points": joined, "fill": "none", "stroke": colour, "stroke-width": "1.5"}
        )

    def text(
        self,
        x: float,
        y: float,
        text: str,
        *,
        size: float = 11,
        colour: str = "currentColor",
        bold: bool = False,
        href: str = "",
    ) -> None:
        """Write a text that begins at a place."""
        parent = Tree.SubElement(self._root, "a", {"href": href}) if href else self._root
        style = {"x": f"{x:.1f}", "y": f"{y:.1f}", "font-size": f"{size:g}", "fill": colour}
        drawn = Tree.SubElement(parent, "text", style | ({"font-weight": "600"} if bold else {}))
        drawn.text = text.translate(_FORBIDDEN)
        self.height = max(self.height, y)

    def written(self) -> str:
        """Return the drawing as SVG."""
        self._root.set("viewBox", f"0 0 {self.width:g} {self.height + 4:g}")
        return Tree.tostring(self._root, encoding="unicode")
