"""Watches gateways for the pages: one loop per gateway, which asks only while somebody looks."""

from __future__ import annotations

import asyncio
import logging
import time
from collections.abc import Callable
from typing import Final

from ropeway.control.async_client import AsyncControlClient
from ropeway.control.client import ControlTarget
from ropeway.dashboard.answers import CallerRow, StatusAnswer, read
from ropeway.dashboard.history import Histories
from ropeway.errors import ControlRefused, ControlUnavailable, RopewayError
from ropeway.tasks import Supervised, describe

__all__ = ["GatewayWatch"]

log = logging.getLogger("ropeway.dashboard")

_PERIOD_S: Final = 1.0
_LONGEST_PERIOD_S: Final = 10.0
_SHARE: Final = 0.02
"""The part of the time in which a gateway may be busy with our question: one that takes long is asked less often."""
_LOOKED_AT_S: Final = 5.0
"""A gateway at which no page has looked for so long is not asked."""
_RIGHTS_S: Final = 10.0
_REFUSED_S: Final = 10.0
"""Wrong tokens are counted, and lead to a lockout: they are shown seldom."""
_ALL_RIGHTS: Final = frozenset(("observe", "configure", "operate"))


class GatewayWatch:
    """A gateway as one viewer may see it: its last status, or why there is none.

    ``key`` names it in addresses of pages. ``rights`` are those that the gateway gives.
    """

    def __init__(self, key: str, target: ControlTarget, *, clock: Callable[[], float] = time.monotonic) -> None:
        self.key, self.target = key, target
        self.client = AsyncControlClient(target)
        self.status: StatusAnswer | None = None
        self.error = ""
        self.caller = CallerRow()
        self.rates = Histories()
        self.asked = 0
        self.answered = asyncio.Event()
        """Set once the gateway has answered, or not."""
        self._clock = clock
        self._looked_at = clock()
        self._rights_at = float("-inf")
        self._wanted = asyncio.Event()
        self._resting = False
        self._loop = Supervised(self._run, f"dashboard {key}").start()

    @property
    def name(self) -> str:
        """The name by which the gateway calls itself, or the one that it is asked by."""
        return self.status.name if self.status is not None else self.target.name

    @property
    def idle_s(self) -> float:
        """The time since a page has looked."""
        return self._clock() - self._looked_at

    @property
    def resting(self) -> bool:
        """Whether the gateway is not asked, as nobody looks."""
        return self._resting

    def look(self) -> None:
        """Say that a page looks at it."""
        self._looked_at = self._clock()
        self._wanted.set()

    def may(self, right: str) -> bool:
        """Return whether the gateway gives us a right."""
        return right in self.caller.rights

    async def close(self) -> None:
        """End watching."""
        await self._loop.close()
        await self.client.close()

    async def _run(self) -> None:
        while True:
            pause_s = await self.ask()
            self.answered.set()
            await asyncio.sleep(pause_s)
            if self.idle_s > _LOOKED_AT_S:
                self._wanted.clear()
                self._resting = True
                await self._wanted.wait()
                self._resting = False

    async def ask(self) -> float:
        """Ask once, and return how long to wait before the next time."""
        began = self._clock()
        self.asked += 1
        try:
            await self._ask_rights(began)
            status = read(StatusAnswer, await self.client.get("/v1/status"))
        except ControlUnavailable as error:
            self._failed(error)
            return _PERIOD_S
        except RopewayError as error:
            self._failed(error)
            return _REFUSED_S
        self.status, self.error = status, ""
        self.rates.add({route.key: route.rate_hz or 0.0 for route in status.routes})
        return min(max((self._clock() - began) / _SHARE, _PERIOD_S), _LONGEST_PERIOD_S)

    async def _ask_rights(self, now: float) -> None:
        if now - self._rights_at < _RIGHTS_S:
            return
        try:
            self.caller = read(CallerRow, await self.client.get("/v1/caller"))
        except ControlRefused as error:
            if error.status != 404:
                raise
            self.caller = CallerRow(rights=_ALL_RIGHTS)  # an older gateway, which refuses what is not allowed
        self._rights_at = now

    def _failed(self, error: RopewayError) -> None:
        text = describe(error)
        if text != self.error:
            log.warning("%s: %s", self.key, text)
        self.error, self._rights_at = text, float("-inf")
        self.status = None
        self.rates.add({})
