"""Keeps the topics of departed clients for a while, so that their last messages are delivered."""

from __future__ import annotations

import asyncio
import contextlib
import logging
from typing import Protocol

from ropeway import aio
from ropeway.limits import LINGERING_CLIENTS
from ropeway.tasks import Supervised, end

__all__ = ["Lingerer", "Lingering"]

log = logging.getLogger("ropeway.server")


class Lingerer(Protocol):
    """The remains of a client: topics that it published."""

    @property
    def lingers(self) -> bool:
        """Return whether any topic is left."""

    async def withdraw(self, name: str | None = None) -> None:
        """Take back one topic, or all."""


class Lingering:
    """Withdraws the topics of each client ``keep_s`` after it left, or as soon as too many clients linger.

    One task does it for all of them: what is in the table is always somebody's to withdraw.
    """

    def __init__(self, keep_s: float) -> None:
        self._keep_s = keep_s
        self._until: dict[Lingerer, float] = {}  # by the loop's clock, who left first comes first
        self._wake = asyncio.Event()
        self._task: Supervised | None = None

    def __len__(self) -> int:
        return len(self._until)

    def add(self, client: Lingerer) -> None:
        """Let a client linger that has just left."""
        self._until[client] = asyncio.get_running_loop().time() + self._keep_s
        self._wake.set()
        if self._task is None:
            self._task = Supervised(self._run, "clients that left").start()

    async def advertised(self, topic: str) -> None:
        """Withdraw a topic that somebody publishes again: nothing of those who left need linger on it."""
        for client in list(self._until):
            await client.withdraw(topic)
            if not client.lingers:
                self._until.pop(client, None)

    async def close(self) -> None:
        """Withdraw everything now."""
        await end(self._task)
        self._task = None
        while self._until:
            await self._withdraw_first()

    async def _run(self) -> None:
        loop = asyncio.get_running_loop()
        while True:
            self._wake.clear()
            if not self._until:
                await self._wake.wait()
                continue
            wait_s = next(iter(self._until.values())) - loop.time()
            if wait_s <= 0 or len(self._until) > LINGERING_CLIENTS:
                await self._withdraw_first()
                continue
            with contextlib.suppress(TimeoutError):
                async with aio.timeout(wait_s):
                    await self._wake.wait()

    async def _withdraw_first(self) -> None:
        client = next(iter(self._until))
        try:
            await client.withdraw()
        except Exception:  # whatever failed with one client is no reason to keep the others for ever
            log.exception("the topics of a client that left could not be withdrawn")
        finally:
            self._until.pop(client, None)
