"""The map, plots and latency windows as drawings."""

from __future__ import annotations

from xml.etree import ElementTree as Tree

import pytest

from ropeway.dashboard.answers import GroupRow, StatusAnswer, read
from ropeway.dashboard.map import MappedGateway, draw_map, shares
from ropeway.dashboard.pages.groups import draw_windows
from ropeway.dashboard.plot import draw_plot, numbers_of
from ropeway.dashboard.svg import Drawing, colour_of, points

SVG = "{http://www.w3.org/2000/svg}"
ROUTE = {"name": "/odom", "operation": "publish", "address": "ws://c:1", "state": "active", "rate_hz": 49.8}
HOSTILE = [
    "<script>alert(1)</script>",
    '"><img src=x onerror=alert(1)>',
    "a\0b\x1b[31m",
    "\ud800",
    "javascript:alert(1)",
]


def status(name: str, **parts: object) -> StatusAnswer:
    return read(StatusAnswer, {"name": name, **parts})


def robot(name: str = "robot", route: dict[str, object] = ROUTE, **link: object) -> MappedGateway:
    remote = {"address": "ws://c:1", "state": "connected", "gateway": "cloud", "rtt_ms": 2.4, **link}
    return MappedGateway("robot", name, status(name, remotes=[remote], routes=[route]))


def texts(drawing: str) -> str:
    return " | ".join(text for each in Tree.fromstring(drawing).iter() if (text := each.text))


def test_a_link_between_gateways_that_are_watched() -> None:
    """Two gateways are two boxes, whichever is asked first, with the route and its rate between them."""
    places = [
        MappedGateway("cloud", "cloud", status("cloud", sessions=[{"peer": "1.2.3.4:5", "gateway": "robot"}])),
        robot(),
    ]
    drawing = draw_map(places, 400)
    assert len(Tree.fromstring(drawing).findall(f".//{SVG}rect")) == 2
    assert "/odom 49.8 Hz" in texts(drawing)
    assert "connected 2.4 ms" in texts(drawing)
    assert shares(places) == {"active": 1}


def test_a_gateway_that_is_away_and_a_client() -> None:
    """A gateway that does not answer is a red box, and a client that is no gateway is named."""
    cloud = MappedGateway("cloud", "cloud", status("cloud", sessions=[{"peer": "1.2.3.4:5", "agent": "roslibjs"}]))
    drawing = draw_map([cloud, MappedGateway("robot", "robot", error="nobody answers")], 760)
    assert "client 1.2.3.4:5 roslibjs" in texts(drawing)
    assert "away" in texts(drawing)
    assert colour_of("gone") in drawing


def test_many_routes_are_drawn_as_some_and_a_number() -> None:
    """A link with a thousand routes is as high as one with a few."""
    routes = [{**ROUTE, "name": f"/topic{number}"} for number in range(1_000)]
    remote = {"address": "ws://c:1", "state": "connected"}
    drawing = draw_map([MappedGateway("r", "r", status("r", remotes=[remote], routes=routes))], 400)
    assert "and 986 more routes" in texts(drawing)


@pytest.mark.parametrize("text", HOSTILE)
def test_hostile_names_are_texts(text: str) -> None:
    """Whatever a gateway calls things, a drawing has no other elements than its own, and links lead to our pages."""
    drawing = draw_map([robot(text, {**ROUTE, "name": text, "error": text}, error=text, state=text, gateway=text)], 760)
    found = Tree.fromstring(drawing)
    assert {each.tag.removeprefix(SVG) for each in found.iter()} <= {
        "svg",
        "a",
        "rect",
        "text",
        "line",
        "title",
        "polygon",
    }
    assert all(each.get("href", "").startswith("/routes?") for each in found.findall(f".//{SVG}a"))


def test_nothing_to_show() -> None:
    """Drawings of nothing are drawings."""
    for drawing in (draw_map([], 400), draw_plot({}, 400, 120), Drawing(10).written()):
        assert Tree.fromstring(drawing).tag == f"{SVG}svg"
    assert points([], 100, 20) == ""


def test_a_plot() -> None:
    """Lines are named with their newest value; one that never changes has a place, too."""
    drawing = draw_plot({"x": [1.0, 2.0, 3.0], "flat": [5.0] * 3}, 400, 3)
    assert "x: 3.0" in texts(drawing)
    assert "flat: 5.0" in texts(drawing)


def test_numbers_of_a_message() -> None:
    """Numbers are found by their paths, in arrays by index; texts and truths are no numbers, but true is one."""
    value = {"pose": {"x": 1, "name": "a"}, "ranges": [0.5, 1.5, "… 900 in all"], "on": True}
    assert dict(numbers_of(value)) == {"pose.x": 1.0, "ranges[0]": 0.5, "ranges[1]": 1.5, "on": 1.0}


def test_latency_windows() -> None:
    """A member has its figures in milliseconds; one of whom nothing is known says so."""
    latency = {"answered": 9, "pending": 1, "min": 0.01, "median": 0.02, "mean": 0.02, "max": 0.05, "p99": 0.04}
    members = {"edge1": {"here": True, "standing": "good", "latency_s": latency}, "edge2": {"here": True}, "gone": {}}
    drawing = draw_windows(read(GroupRow, {"group": "g", "current": "edge1", "members": members}), 560)
    assert "median 20.0" in texts(drawing)
    assert "nothing is known" in texts(drawing)
    assert "not there" in texts(drawing)
