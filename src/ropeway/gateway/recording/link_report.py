"""Tells how links are and what routes drop, as messages of a recording: channels of JSON with their schemas."""

from __future__ import annotations

import time
from collections.abc import Iterable, Iterator, Mapping
from typing import Any, Final, NamedTuple

import orjson

from ropeway.gateway.link_rows import each_link
from ropeway.gateway.remote import Remote, shown_address
from ropeway.gateway.route import TopicFigures
from ropeway.recording.channel import Recorded, json_channel

__all__ = ["DROPS", "LINKS", "LinkReport", "Loss"]

CONNECTED: Final = "connected"

LINKS: Final = json_channel(
    "/ropeway/links",
    "ropeway.Link",
    link="string",
    title="string",
    state="string",
    before="string",
    error="string",
    rtt_ms="number",
    pace_bps="number",
    bytes_in="integer",
    bytes_out="integer",
    connections="integer",
)
"""The channel of the states of links: at each change (``before`` is what it was), and once a second."""

DROPS: Final = json_channel(
    "/ropeway/drops",
    "ropeway.Drops",
    route="string",
    link="string",
    reason="string",
    count="integer",
    total="integer",
)
"""The channel of messages that did not cross: how many within the last second, by route and reason."""

_FIGURES: Final = ("rtt_ms", "pace_bps", "bytes_in", "bytes_out", "connections")


class Loss(NamedTuple):
    """A link that was connected, and is not any more."""

    link: str
    why: str


class LinkReport:
    """Looks at remotes, and makes messages of what it sees."""

    def __init__(self) -> None:
        self._remotes: dict[str, str] = {}
        self._links: dict[str, str] = {}
        self._dropped: dict[tuple[str, str, str], int] = {}

    def look(self, remotes: Iterable[Remote], *, figures: bool) -> tuple[list[Recorded], list[Loss]]:
        """Return messages on links whose state has changed, with ``figures`` on all, and the links that were lost.

        The several links of one remote are looked at with ``figures``, or when the remote as a whole has changed.
        """
        messages: list[Recorded] = []
        losses: list[Loss] = []
        seen: set[str] = set()
        for remote in remotes:
            address, state = shown_address(remote.config), remote.state
            if not figures and self._remotes.get(address) == state:
                continue
            self._remotes[address] = state
            for name, row in each_link([remote.status()]):
                seen.add(name)
                before, now = self._links.get(name, ""), str(row.get("state", ""))
                self._links[name] = now
                if figures or before != now:
                    messages.append(_link(name, row, before))
                if before == CONNECTED != now:
                    losses.append(Loss(name, str(row.get("error", ""))))
        gone = self._links.keys() - seen if figures else set()
        messages += [_link(name, {"state": "gone"}, self._links.pop(name)) for name in gone]
        return messages, losses

    def drops(self, remotes: Iterable[Remote]) -> Iterator[Recorded]:
        """Yield messages on what routes have dropped since the last time, by reason."""
        before, self._dropped = self._dropped, {}
        now_ns = time.time_ns()
        for remote in remotes:
            for row in remote.routes():
                if not isinstance(row.figures, TopicFigures):
                    continue
                for reason, total in row.figures.drops.items():
                    self._dropped[row.key, row.address, reason] = total
                    count = total - before.get((row.key, row.address, reason), 0)
                    if count > 0:
                        about = {"route": f"{row.operation} {row.name}", "link": row.address, "reason": reason}
                        yield Recorded(DROPS, now_ns, orjson.dumps({**about, "count": count, "total": total}))


def _link(name: str, row: Mapping[str, Any], before: str) -> Recorded:
    figures = {key: row[key] for key in _FIGURES if row.get(key) is not None}
    about = {"link": name, "title": row.get("title", ""), "state": row.get("state", ""), "before": before}
    return Recorded(LINKS, time.time_ns(), orjson.dumps({**about, "error": row.get("error", ""), **figures}))
