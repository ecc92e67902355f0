"""Where samples arrive."""

from __future__ import annotations

import asyncio
from collections.abc import Sequence

from ropeway import aio
from ropeway.graph.base import Sample
from tests.support.until import PATIENCE_S

__all__ = ["Inbox"]


class Inbox:
    """A callback that keeps what arrives and lets a test wait for it."""

    def __init__(self) -> None:
        self.samples: list[Sample] = []
        self.batches = 0
        self._arrived = asyncio.Event()

    def __call__(self, batch: Sequence[Sample]) -> None:
        self.samples.extend(batch)
        self.batches += 1
        self._arrived.set()

    @property
    def payloads(self) -> list[bytes]:
        return [bytes(s.payload) for s in self.samples]

    @property
    def texts(self) -> list[str]:
        """The strings, where all that arrived are std_msgs/msg/String in CDR."""
        return [payload[8:-1].decode() for payload in self.payloads]

    async def wait(self, count: int, timeout_s: float = PATIENCE_S) -> list[Sample]:
        """Wait until so many samples are here, and return all of them."""
        async with aio.timeout(timeout_s):
            while len(self.samples) < count:
                self._arrived.clear()
                await self._arrived.wait()
        return self.samples
