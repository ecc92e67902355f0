"""Draws the map: gateways and what they are linked with, every route between them, coloured by its state."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Final
from urllib.parse import urlencode

from ropeway.control.figures import shown_number
from ropeway.dashboard.answers import LinkRow, RouteRow, SessionRow, StatusAnswer
from ropeway.dashboard.svg import Drawing, colour_of
from ropeway.dashboard.texts import fitted, rate_of

__all__ = ["MappedGateway", "draw_map", "shares"]

_ROW: Final = 18.0
_HEAD: Final = 40.0
_GAP: Final = 14.0
_MOST_ROUTES: Final = 14
"""Routes of one link that are drawn; one line stands for the others."""


@dataclass
class MappedGateway:
    """A gateway that is watched: its status, or why there is none."""

    key: str
    name: str
    status: StatusAnswer | None = None
    error: str = ""


@dataclass
class _Box:
    """The other end of links."""

    name: str
    lines: list[str]
    colour: str
    href: str = ""
    rows: int = 0
    y: float = 0.0
    taken: int = 0

    @property
    def height(self) -> float:
        return _HEAD + self.rows * _ROW

    def slot(self) -> float:
        self.taken += 1
        return self.y + _HEAD + (self.taken - 0.5) * _ROW - 4


@dataclass
class _Lines:
    """The routes of one link, from the box at the left to that at the right."""

    left: _Box
    right: _Box
    link: LinkRow
    routes: list[RouteRow] = field(default_factory=list)
    more: int = 0


def draw_map(places: Sequence[MappedGateway], width: float) -> str:
    """Return the map as SVG, ``width`` units wide."""
    drawing = Drawing(width)
    lefts, rights, links = _arranged(places)
    side = width * 0.27
    for boxes in (lefts, rights):
        y = 2.0
        for box in boxes:
            box.y, y = y, y + box.height + _GAP
    for x, boxes in ((1.0, lefts), (width - side - 1, rights)):
        for box in boxes:
            _draw_box(drawing, box, x, side)
    for lines in links:
        _draw_lines(drawing, lines, side + 3, width - side - 3)
    return drawing.written()


def _arranged(places: Sequence[MappedGateway]) -> tuple[list[_Box], list[_Box], list[_Lines]]:
    """Return the boxes of both sides: those that dial at the left, those that are dialled and clients at the right."""
    dialled = {link.gateway for place in places if place.status for link in place.status.remotes if link.gateway}
    lefts: list[_Box] = []
    rights: dict[str, _Box] = {}
    links: list[_Lines] = []
    for place in places:
        if place.status is None or place.status.remotes or place.name not in dialled:
            lefts.append(_gateway_box(place))
        else:
            rights[place.name] = _gateway_box(place)
    by_key = {place.key: box for place, box in zip([p for p in places if p.name not in rights], lefts, strict=True)}
    for place in places:
        if place.status is None or place.key not in by_key:
            continue
        for link in place.status.remotes:
            right = rights.setdefault(link.gateway or link.address, _remote_box(link))
            links.append(_lines(by_key[place.key], right, link, place.status.routes))
    known = {place.name for place in places}
    for place in places:
        for session in place.status.sessions if place.status is not None else ():
            if session.gateway not in known or not session.gateway:
                _add_client(by_key.get(place.key) or rights[place.name], session)
    return lefts, list(rights.values()), links


def _gateway_box(place: MappedGateway) -> _Box:
    href = "/routes?" + urlencode({"gateway": place.key})
    if place.status is None:
        return _Box(place.name, ["away"], colour_of("gone"), href, rows=1)
    graphs = [f"{graph.topics} topics on {graph.graph.partition('?')[0]}" for graph in place.status.graphs]
    return _Box(place.name, graphs[:3] or ["no network"], colour_of("active"), href, rows=max(len(graphs[:3]) - 1, 0))


def _remote_box(link: LinkRow) -> _Box:
    return _Box(link.title or link.gateway or link.address, [link.address], colour_of(link.state))


def _add_client(box: _Box, session: SessionRow) -> None:
    shown = session.gateway or session.agent or session.dialect
    if len(box.lines) < 8:
        box.lines.append(f"client {session.peer} {shown}")
        box.rows = max(box.rows, len(box.lines) - 1)


def _lines(left: _Box, right: _Box, link: LinkRow, routes: Sequence[RouteRow]) -> _Lines:
    mine = [route for route in routes if route.address == link.address]
    lines = _Lines(left, right, link, mine[:_MOST_ROUTES], max(len(mine) - _MOST_ROUTES, 0))
    rows = len(lines.routes) + (2 if lines.more else 1)
    left.rows += rows
    right.rows += rows
    return lines


def _draw_box(drawing: Drawing, box: _Box, x: float, width: float) -> None:
    room = int(width / 6.2)
    drawing.box(x, box.y, width, box.height, colour=box.colour, href=box.href)
    drawing.text(x + 8, box.y + 17, fitted(box.name, room - 2), size=13, bold=True, href=box.href)
    for number, line in enumerate(box.lines):
        drawing.text(x + 8, box.y + 32 + 13 * number, fitted(line, room), size=9.5)


def _draw_lines(drawing: Drawing, lines: _Lines, x1: float, x2: float) -> None:
    link = lines.link
    room = int((x2 - x1) / 6)
    y1, y2 = lines.left.slot(), lines.right.slot()
    figures = f" {shown_number(link.rtt_ms)} ms" if link.rtt_ms is not None else ""
    shown = f"{link.state}{figures}" + (f": {link.error}" if link.error else "")
    drawing.text(x1 + 4, y1 - 6, fitted(shown, room), size=10, colour=colour_of(link.state), bold=True)
    for route in lines.routes:
        y1, y2 = lines.left.slot(), lines.right.slot()
        start, end = (x1, y1), (x2, y2)
        if route.inward:
            start, end = end, start
        colour = colour_of(route.state)
        title = f"{route.operation} {route.name}: {route.state}" + (f" ({route.why})" if route.why else "")
        drawing.line(*start, *end, colour=colour, title=title)
        rate = rate_of(route)
        drawing.text(x1 + 8, y1 - 3, f"{fitted(route.name, room - len(rate) - 2)} {rate}", size=10, colour=colour)
    if lines.more:
        y1, _ = lines.left.slot(), lines.right.slot()
        drawing.text(x1 + 8, y1 - 3, f"and {lines.more} more routes", size=10)


def shares(places: Sequence[MappedGateway]) -> Mapping[str, int]:
    """Return how many routes are in each state, over all gateways."""
    counts: dict[str, int] = {}
    for place in places:
        for route in place.status.routes if place.status is not None else ():
            counts[route.state] = counts.get(route.state, 0) + 1
    return counts
