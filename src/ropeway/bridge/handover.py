"""Hands a topic over to another publisher or subscription, without a message that is lost or passed on twice."""

from __future__ import annotations

import asyncio
import contextlib
from collections.abc import Sequence
from typing import Final

from ropeway import aio
from ropeway.delivery.passage import Passage
from ropeway.delivery.pipeline import Drop
from ropeway.graph.base import Publisher, Sample
from ropeway.graph.link_parts import Draining

__all__ = ["Overlap", "drained", "matched"]

_MATCH_S: Final = 1.0  # a far gateway tells its readers within a round trip; a DDS reader matches in milliseconds
_FIRST_S: Final = 0.5  # of a topic that is silent for longer, nothing is lost between the two
_DRAIN_S: Final = 1.0
_LOOK_S: Final = 0.005


async def matched(new: Publisher, old: Publisher, limit_s: float = _MATCH_S) -> None:
    """Wait until a new publisher has as many readers as the old one, for ``limit_s`` at most."""
    wanted = old.subscribers
    if not wanted:
        return
    changed = asyncio.Event()
    new.on_demand(lambda _: changed.set())
    with contextlib.suppress(TimeoutError):
        async with aio.timeout(limit_s):
            while new.subscribers is not None and new.subscribers < (old.subscribers or 0):
                changed.clear()
                await changed.wait()


async def drained(publisher: Publisher, limit_s: float = _DRAIN_S) -> None:
    """Wait until nothing waits for the link any more and all of it has arrived, for ``limit_s`` at most.

    A small message may go over a second connection, and be overtaken by the word that the topic is withdrawn.
    """
    if not isinstance(publisher, Draining):
        return
    with contextlib.suppress(TimeoutError):
        async with aio.timeout(limit_s):
            while publisher.waiting:  # noqa: ASYNC110 - an outbox tells nobody
                await asyncio.sleep(_LOOK_S)
            await publisher.arrived()


class Overlap:
    """The time in which two subscriptions feed one passage: what comes over both is passed on once."""

    def __init__(self, passage: Passage) -> None:
        self._passage = passage
        self._seen: set[tuple[bytes, int]] = set()
        self._came = asyncio.Event()
        passage.steps = [self._once, *passage.steps]

    def first(self, batch: Sequence[Sample]) -> None:
        """Take messages of the new subscription, and pass them on."""
        self._came.set()
        self._passage.pass_on(batch)

    async def wait(self, limit_s: float = _FIRST_S) -> None:
        """Wait until the new subscription has brought something, for ``limit_s`` at most."""
        with contextlib.suppress(TimeoutError):
            async with aio.timeout(limit_s):
                await self._came.wait()

    def end(self) -> None:
        """Pass everything on again."""
        self._passage.steps = [step for step in self._passage.steps if step != self._once]

    def _once(self, sample: Sample) -> Sample | Drop | None:
        key = (sample.origin, sample.seq)
        if key in self._seen:
            return None
        self._seen.add(key)
        return sample
