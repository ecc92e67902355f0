"""Publishes how links and routes are as ROS diagnostics (REP 107), for the tools that robots have for them."""

from __future__ import annotations

import asyncio
import time
from collections.abc import Callable, Iterable, Iterator, Mapping
from contextlib import AsyncExitStack
from typing import Any, Final

from ropeway.graph.base import SEQ_NONE, Publisher, Sample
from ropeway.hub.hub import Hub
from ropeway.tasks import Supervised
from ropeway.types import TypeRegistry

__all__ = ["TOPIC", "TYPE", "Diagnostics", "statuses"]

TOPIC: Final = "/diagnostics"
TYPE: Final = "diagnostic_msgs/msg/DiagnosticArray"
_PERIOD_S: Final = 1.0  # as diagnostic updaters of ROS do
_OK, _WARN, _ERROR = 0, 1, 2
_WAITING: Final = ("connecting", "waiting", "waiting to retry", "taken", "paused")


class Diagnostics:
    """Publishes one status per link and one per route on local graphs, once a second while somebody reads."""

    def __init__(self, name: str, status: Callable[[], Mapping[str, Any]], registry: TypeRegistry) -> None:
        self._name, self._status = name, status
        self._codec = registry.codec(TYPE)
        self._publishers: list[Publisher] = []

    async def open(self, hubs: Iterable[Hub], stack: AsyncExitStack) -> None:
        """Publish from now on, as long as ``stack`` is open."""
        for hub in hubs:
            view = hub.view("diagnostics", alone=True)
            stack.push_async_callback(view.close)
            self._publishers.append(await view.create_publisher(TOPIC, TYPE))
        stack.push_async_callback(Supervised(self._run, "diagnostics").start().close)

    async def _run(self) -> None:
        while True:
            await asyncio.sleep(_PERIOD_S)
            self.tell()

    def tell(self) -> None:
        """Publish once, where somebody reads."""
        wanted = [publisher for publisher in self._publishers if publisher.subscribers != 0]
        if not wanted:
            return
        message = {"status": list(statuses(self._name, self._status()))}
        payload, now_ns = self._codec.from_json(message), time.time_ns()
        for publisher in wanted:
            publisher.publish(Sample(payload, TYPE, now_ns, b"", SEQ_NONE))


def statuses(name: str, status: Mapping[str, Any]) -> Iterator[dict[str, Any]]:
    """Yield a ``diagnostic_msgs/DiagnosticStatus`` for each link and each route in the status of a gateway."""
    for remote in status["remotes"]:
        told = {key: remote[key] for key in ("rtt_ms", "pace_bps", "connections") if remote.get(key) is not None}
        yield _diagnostic(name, f"link {remote['address']}", remote["state"], remote.get("error", ""), told)
    for route in status["routes"]:
        figures = ("rate_hz", "delay_ms", "publishers", "readers", "encoding", "requests", "took_ms")
        told = {key: route[key] for key in figures if route.get(key) is not None}
        told.update({f"dropped: {reason}": count for reason, count in route.get("drops", {}).items()})
        said = route["error"] or route.get("reason", "")
        yield _diagnostic(name, f"{route['operation']} {route['name']}", route["state"], said, told, route["error"])


def _diagnostic(
    gateway: str, what: str, state: str, said: str, told: Mapping[str, Any], error: str = ""
) -> dict[str, Any]:
    level = _ERROR if state in ("failed", "closed") or error else _WARN if state in _WAITING else _OK
    return {
        "level": level,
        "name": f"{gateway}: {what}",
        "message": f"{state}: {said}" if said else state,
        "hardware_id": gateway,
        "values": [{"key": key, "value": str(value)} for key, value in told.items()],
    }
