"""Watches the routes of a running gateway: why one passes nothing is known, and said, without being asked."""

from __future__ import annotations

import asyncio
import logging
import time
from collections.abc import Callable, Iterable, Iterator
from typing import Final, NamedTuple

from ropeway.bridge.topic import TopicBridge
from ropeway.gateway.config.config import Route
from ropeway.gateway.explain.explanation import Finding, Subject
from ropeway.gateway.explain.routes import reason_of
from ropeway.gateway.remote import Remote
from ropeway.gateway.route import Bridge, Doubt

__all__ = ["LOOK_S", "RouteWatch"]

log = logging.getLogger("ropeway.gateway")

LOOK_S: Final = 2.0
_TURN_S: Final = 0.001  # what waits meanwhile is not late by more than a message on its way through
_MOST_OF_A_CORE: Final = 0.02  # whatever there is to look at: a thousand silent routes take some seconds
_CERTAIN: Final = (Subject.TYPE, Subject.QOS)
"""Findings that stay until somebody changes something: told at once, and an error of the route."""
_LATER: Final = (Subject.SOURCE, Subject.NETWORK)
"""Findings that may end by themselves: told once they have stayed for ``_PATIENCE`` looks."""
_PATIENCE: Final = 3


class _Seen(NamedTuple):
    finding: Finding
    looks: int


class RouteWatch:
    """Keeps the ``doubt`` of each route that passes nothing, as far as a gateway knows it without asking the remote."""

    def __init__(self, remotes: Callable[[], Iterable[Remote]], *, look_s: float = LOOK_S) -> None:
        self._remotes = remotes
        self._look_s = look_s
        self._seen: dict[str, _Seen] = {}
        self._passed: dict[str, int] = {}

    async def run(self) -> None:
        """Look at all routes every few seconds, until cancelled; messages do not wait for more than one route."""
        clock = time.perf_counter
        while True:
            await asyncio.sleep(self._look_s)
            began = clock()
            for _ in self._looks():
                took_s = clock() - began
                if took_s >= _TURN_S:
                    await asyncio.sleep(took_s / _MOST_OF_A_CORE)
                    began = clock()

    def look(self) -> None:
        """Look at all routes once, and log what is new."""
        for _ in self._looks():
            pass

    def _looks(self) -> Iterator[None]:
        """Look at all routes once; yield after each."""
        seen: dict[str, _Seen] = {}
        passed: dict[str, int] = {}
        for remote in list(self._remotes()):
            for key, running in list(remote.running.items()):
                yield
                connected = remote.state == "connected"  # if it is not, the link tells why
                passed[key] = _passed(running.bridge)
                still = passed[key] == self._passed.get(key, 0)
                finding = reason_of(remote, running) if connected and still else None
                if finding is None:
                    running.doubt = None
                    continue
                running.doubt = Doubt(finding.text, finding.subject in _CERTAIN)
                seen[key] = self._look_at(key, running.route, finding)
        self._seen, self._passed = seen, passed

    def _look_at(self, key: str, route: Route, finding: Finding) -> _Seen:
        before = self._seen.get(key)
        looks = before.looks + 1 if before is not None and before.finding == finding else 1
        due = 1 if finding.subject in _CERTAIN else _PATIENCE if finding.subject in _LATER else 0
        if looks == due:
            # Without a name that is near, it may just not have started yet.
            odd = finding.subject is not Subject.SOURCE or finding.near
            log.log(logging.WARNING if odd else logging.INFO, "%s %s: %s", route.operation, route.name, finding.text)
        return _Seen(finding, looks)


def _passed(bridge: Bridge) -> int:
    return bridge.meter.messages if isinstance(bridge, TopicBridge) else sum(bridge.counts.values())
