"""ropeway.gateway.recording.link_report: the state of links as messages."""

from __future__ import annotations

from typing import Any, cast

import orjson

from ropeway.gateway.config.config import parse
from ropeway.gateway.recording.link_report import DROPS, LINKS, LinkReport
from ropeway.gateway.remote import Remote
from ropeway.gateway.route import RouteStatus, TopicFigures


class Link(Remote):
    """A link whose state and drops a test says."""

    def __init__(self, state: str) -> None:
        super().__init__(parse([{"address": "ws://h:1"}]).remotes[0])
        self.now, self.members = state, cast("list[dict[str, Any]]", [])
        self.dropped: dict[str, int] = {}

    @property
    def state(self) -> str:
        return self.now

    def status(self) -> dict[str, Any]:
        more = {"members": self.members} if self.members else {}
        return {"address": "ws://h:1", "state": self.now, "error": "", "rtt_ms": 4.5, **more}

    def routes(self) -> list[RouteStatus]:
        figures = TopicFigures(drops=dict(self.dropped))
        about = ("publish", "/a", "/a", "ws://h:1", "std_msgs/msg/String")
        return [RouteStatus("key", "topic", "remotes[0].publish[0]", *about, "active", figures=figures)]


def test_states() -> None:
    """A change of state is told at once, with what it was; figures when they are asked for; a loss once."""
    link, report = Link("connecting"), LinkReport()
    (first,), losses = report.look([link], figures=False)
    assert (first.channel, orjson.loads(first.payload)["state"], losses) == (LINKS, "connecting", [])
    assert report.look([link], figures=False) == ([], [])
    link.now = "connected"
    (change,), _ = report.look([link], figures=False)
    assert (orjson.loads(change.payload)["before"], orjson.loads(change.payload)["rtt_ms"]) == ("connecting", 4.5)
    assert len(report.look([link], figures=True)[0]) == 1
    link.now = "waiting to retry"
    assert [loss.link for loss in report.look([link], figures=False)[1]] == ["ws://h:1"]
    assert report.look([link], figures=True)[1] == []
    (gone,), _ = report.look([], figures=True)
    assert orjson.loads(gone.payload)["state"] == "gone"


def test_members() -> None:
    """Each member of a group is a link, whose loss is seen though the group stands."""
    link, report = Link("connected"), LinkReport()
    link.members = [{"address": "ws://a", "state": "connected"}, {"address": "ws://b", "state": "connected"}]
    report.look([link], figures=True)
    link.members[1]["state"] = "connecting"
    assert [loss.link for loss in report.look([link], figures=True)[1]] == ["ws://b"]


def test_drops() -> None:
    """Only what was dropped since the last time is told, by reason, with the count and the total."""
    link, report = Link("connected"), LinkReport()
    link.dropped = {"late": 3}
    (told,) = report.drops([link])
    assert told.channel is DROPS
    assert orjson.loads(told.payload) == {
        "route": "publish /a",
        "link": "ws://h:1",
        "reason": "late",
        "count": 3,
        "total": 3,
    }
    assert list(report.drops([link])) == []
    link.dropped = {"late": 5, "full": 1}
    assert [
        (orjson.loads(one.payload)["reason"], orjson.loads(one.payload)["count"]) for one in report.drops([link])
    ] == [
        ("late", 2),
        ("full", 1),
    ]
