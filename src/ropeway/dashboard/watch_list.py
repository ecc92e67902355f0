"""Finds the gateways that the dashboard shows, and holds a ``GatewayWatch`` of each for every kind of viewer."""

from __future__ import annotations

import asyncio
from collections.abc import Sequence
from dataclasses import replace
from typing import Final

from ropeway.control.async_client import AsyncControlClient
from ropeway.control.client import ControlTarget, fleet
from ropeway.dashboard.watch import GatewayWatch
from ropeway.errors import ControlRefused, RopewayError
from ropeway.limits import DASHBOARD_WATCHES
from ropeway.tasks import Supervised

__all__ = ["WatchList"]

_LOOK_S: Final = 3.0
_UNUSED_S: Final = 60.0


class WatchList:
    """The gateways that were named, or else those that run on this machine as they come and go.

    A viewer with a token of his own is shown those over TCP, with that token; the keeper of the dashboard's key is
    shown all, as the user whose process this is.
    """

    def __init__(self, targets: Sequence[ControlTarget] | None = None) -> None:
        self._named = targets is not None
        self._targets = _by_key(targets or ())
        self._watches: dict[tuple[str, str], GatewayWatch] = {}
        self._loop = Supervised(self._run, "dashboard gateways").start()

    def watches(self, token: str | None = None) -> list[GatewayWatch]:
        """Return the gateways that a viewer may see, in the order of their names; ``token`` is the viewer's own."""
        found = []
        for key, target in self._targets.items():
            if token is None:
                found.append(self._watch(key, "", target))
            elif target.socket is None:
                found.append(self._watch(key, token, _with(target, token)))
        return found

    async def knows(self, token: str) -> bool:
        """Return whether a gateway takes a token. Raises ``ControlRefused`` where none answers that could."""
        targets = [target for target in self._targets.values() if target.socket is None]
        answers = [await _takes(_with(target, token)) for target in targets]
        if answers and set(answers) == {None}:
            raise ControlRefused(503, "no gateway that takes tokens answers; log in with the key of the dashboard")
        return True in answers

    async def close(self) -> None:
        """End watching."""
        await self._loop.close()
        await asyncio.gather(*(watch.close() for watch in self._watches.values()))

    def _watch(self, key: str, token: str, target: ControlTarget) -> GatewayWatch:
        watch = self._watches.get((key, token))
        if watch is None:
            if len(self._watches) >= DASHBOARD_WATCHES:
                raise ControlRefused(503, f"{DASHBOARD_WATCHES} gateways are watched already, with all tokens together")
            watch = self._watches[key, token] = GatewayWatch(key, target)
        return watch

    async def _run(self) -> None:
        while True:
            if not self._named:
                self._targets = _by_key(await asyncio.to_thread(fleet)) | {
                    key: watch.target for (key, token), watch in self._watches.items() if not token
                }
            for place, watch in list(self._watches.items()):
                if watch.idle_s > _UNUSED_S:
                    del self._watches[place]
                    await watch.close()
            await asyncio.sleep(_LOOK_S)


def _by_key(targets: Sequence[ControlTarget]) -> dict[str, ControlTarget]:
    """Return targets by names that differ."""
    found: dict[str, ControlTarget] = {}
    for target in targets:
        name = target.name.encode("utf-8", "replace").decode()  # file names may be no text
        key, number = name, 1
        while key in found:
            number += 1
            key = f"{name} ({number})"
        found[key] = target
    return found


async def _takes(target: ControlTarget) -> bool | None:
    """Return whether a gateway takes the token that is shown to it, ``None`` where it does not answer."""
    client = AsyncControlClient(target)
    try:
        await client.get("/v1/caller")
    except ControlRefused as error:
        return error.status == 404  # of another version, but past its door
    except RopewayError:
        return None
    finally:
        await client.close()
    return True


def _with(target: ControlTarget, token: str) -> ControlTarget:
    return replace(target, headers={"authorization": f"Bearer {token}"})
