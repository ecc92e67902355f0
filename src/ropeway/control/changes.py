"""Notices changes of state: of links, routes, clients and recorders; each becomes an event."""

from __future__ import annotations

import asyncio
from collections.abc import Callable, Iterable, Iterator, Mapping
from typing import TYPE_CHECKING, Any, Final, NamedTuple

if TYPE_CHECKING:
    from ropeway.gateway.gateway import Gateway
    from ropeway.gateway.process.supervisor import Supervisor

__all__ = ["LOOK_S", "ObjectState", "StateChanges", "states_of"]

LOOK_S: Final = 1.0


class ObjectState(NamedTuple):
    """The state of an object of a gateway: ``kind`` is ``link``, ``route``, ``client`` or ``recording``.

    ``why`` is for people.
    """

    kind: str
    name: str
    state: str
    why: str = ""


class StateChanges:
    """Looks at the states every second and tells what has changed.

    ``tell(kind, name, state=..., before=..., why=...)`` is called for each; what has gone has the state ``gone``.
    """

    def __init__(self, states: Callable[[], Iterable[ObjectState]], tell: Callable[..., Any]) -> None:
        self._states, self._tell = states, tell
        self._before: dict[tuple[str, str], ObjectState] = {}

    async def run(self, look_s: float = LOOK_S) -> None:
        """Look until cancelled."""
        while True:
            self.look()
            await asyncio.sleep(look_s)

    def look(self) -> None:
        """Look once."""
        now = {(state.kind, state.name): state for state in self._states()}
        before = self._before
        for key, state in now.items():
            old = before.get(key)
            if old is None or old.state != state.state:
                self._tell(
                    state.kind, state.name, state=state.state, before="" if old is None else old.state, why=state.why
                )
        for key, state in before.items():
            if key not in now:
                self._tell(state.kind, state.name, state="gone", before=state.state, why="")
        self._before = now


def states_of(running: Gateway | Supervisor) -> Iterator[ObjectState]:
    """Yield the states of everything that a gateway, or a supervisor of workers, has."""
    from ropeway.gateway.gateway import Gateway

    if isinstance(running, Gateway):
        yield from _states_here(running)
        return
    status = running.status()
    for remote in status["remotes"]:
        yield ObjectState("link", remote["address"], remote["state"], remote.get("error", ""))
    for route in status["routes"]:
        yield ObjectState(
            "route", _route(route["operation"], route["name"], route["address"]), route["state"], route["error"]
        )
    for session in status["sessions"]:
        yield ObjectState("client", session["peer"], "connected", session["gateway"])
    yield from _recorders(status.get("recordings", ()))


def _states_here(gateway: Gateway) -> Iterator[ObjectState]:
    """Yield the states of a gateway in this process, without all that a status has beside them."""
    from ropeway.gateway.remote import shown_address

    for remote in gateway.remotes:
        address, state = shown_address(remote.config), remote.state
        yield ObjectState("link", address, state, "" if state == "connected" else str(remote.status().get("error", "")))
        for running in remote.joined():
            bridge, name = running.bridge, _route(running.route.operation, running.route.name, address)
            yield ObjectState("route", name, bridge.state if state == "connected" else state, bridge.error)
    for session in gateway.sessions:
        yield ObjectState("client", session.connection.peer, "connected", session.remote.get("name", ""))
    yield from _recorders(gateway.recorders.status())


def _recorders(rows: Iterable[Mapping[str, Any]]) -> Iterator[ObjectState]:
    for row in rows:
        name = f"{row['name']} ({row['part']})" if "part" in row else row["name"]
        yield ObjectState("recording", name, row["state"], row["error"] or row["last"])


def _route(operation: str, name: str, address: str) -> str:
    return f"{operation} {name} {address}"
