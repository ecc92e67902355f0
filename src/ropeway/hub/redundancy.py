"""Publishes a topic on a network where others publish it, too.

Whoever the others are, this gateway then also reads the topic, so that it recognises a message that left the network
here and comes back in a ring of gateways. If another gateway publishes it, one of the two is active and the other is on
standby: the one with the smaller id publishes at once, the other waits 100 ms for each message to appear and publishes
those that do not. So parallel links deliver every message once, and one of them may fail without a gap. If hardly any
of the messages appear, the two bring different ones under one name (transforms of two robots), and both publish at
once.

A message that two gateways passed on before may have come round a ring faster than over this network: it waits, too,
for 30 ms.
"""

from __future__ import annotations

import asyncio
import contextlib
import logging
from collections.abc import Callable, Sequence
from typing import TYPE_CHECKING, Final

from ropeway.errors import RopewayError
from ropeway.graph.base import Graph, Sample, Subscription, look_up

if TYPE_CHECKING:
    from ropeway.graph.deduplication import Seen

__all__ = ["Standby"]

log = logging.getLogger("ropeway.hub")

_WAIT_S: Final = 0.1  # a gateway on a busy machine may be as late as that
_COME_ROUND_S: Final = 0.03
_RARELY: Final = 0.2
_WEIGHT: Final = 0.1  # of one message in the share: about 16 that do not appear in a row settle it
_HELD: Final = 256


class Standby:
    """Watches one published topic. ``received`` and ``published`` are what the network gave us, and what we gave."""

    __slots__ = (
        "_alone",
        "_closed",
        "_gateway_id",
        "_graph",
        "_held",
        "_lock",
        "_monitor",
        "_published",
        "_received",
        "_share",
        "_timer",
        "_topic",
        "_type",
        "duplicates",
        "second",
    )

    def __init__(
        self,
        graph: Graph,
        gateway_id: str,
        topic: str,
        type: str,
        received: Seen,
        published: Seen,
        *,
        alone: bool = False,
    ) -> None:
        self.duplicates = 0
        self._graph, self._gateway_id = graph, gateway_id
        self._topic, self._type = topic, type
        self._received, self._published = received, published
        self.second = False  # a gateway with a smaller id publishes the topic, too
        self._share = 1.0  # of our messages that it brings as well
        self._monitor: Subscription | None = None
        self._held: list[tuple[float, Sample, Callable[[Sample], None]]] = []  # few, and mostly none
        self._timer: asyncio.TimerHandle | None = None
        self._lock = asyncio.Lock()
        self._alone = alone  # what is published here nobody else has to say
        self._closed = False

    @property
    def defers(self) -> bool:
        """Whether another gateway is active and mostly publishes what we would publish."""
        return self.second and self._share > _RARELY

    @property
    def listens(self) -> bool:
        """Whether others publish the topic on this network and we read what they publish."""
        return self._monitor is not None

    async def look(self) -> None:
        """See who else publishes the topic, and act on it."""
        async with self._lock:
            if self._closed or self._alone:
                return
            known = look_up(self._graph, "topic", self._topic)
            others = {p.gateway for p in known.publishers if not p.local} if known is not None else set()
            others.discard(self._gateway_id)
            if others and self._monitor is None:
                with contextlib.suppress(RopewayError):
                    self._monitor = await self._graph.create_subscription(self._topic, self._type, None, self._heard)
            elif not others and self._monitor is not None:
                monitor, self._monitor = self._monitor, None
                await monitor.close()
            # who cannot hear the others would publish everything once more, and late
            second = self._monitor is not None and any(other < self._gateway_id for other in others if other)
            if second != self.second:
                self.second, self._share = second, 1.0
                if not second:
                    self._release_all()  # before anything newer is published
                log.info(
                    "%s: %s %s",
                    self._graph.name,
                    "stands by for another gateway on" if second else "speaks for",
                    self._topic,
                )

    def _heard(self, batch: Sequence[Sample]) -> None:
        for sample in batch:
            self._received.add(sample)
            if self.second and sample.relayed and not self.defers and self._published.has(sample):
                self._share = 1.0

    def hold(self, sample: Sample, publish: Callable[[Sample], None]) -> None:
        """Publish the message in a moment, unless it appears by then."""
        loop = asyncio.get_running_loop()
        wait_s = _COME_ROUND_S if sample.relayed else _WAIT_S
        self._held.append((loop.time() + wait_s, sample, publish))
        if len(self._held) > _HELD:
            self._release()
        if self._timer is None:
            self._timer = loop.call_later(wait_s, self._due)

    def _due(self) -> None:
        self._timer = None
        loop = asyncio.get_running_loop()
        now = loop.time() + 0.001
        while self._held and self._held[0][0] <= now:
            come_round = self._held[0][1].relayed
            appeared = self._release()
            if not come_round:
                self._share += _WEIGHT * (appeared - self._share)
        if self.second and not self.defers:
            self._release_all()
        if self._held:
            self._timer = loop.call_at(self._held[0][0], self._due)

    def _release_all(self) -> None:
        while self._held:
            self._release()

    def _release(self) -> bool:
        """Let the oldest message go; true if it had appeared."""
        _, sample, publish = self._held.pop(0)
        if self._received.has(sample):
            self.duplicates += 1
            return True
        publish(sample)
        return False

    async def close(self) -> None:
        """Stop; what is held goes out now."""
        self._closed = True
        if self._timer is not None:
            self._timer.cancel()
            self._timer = None
        self._release_all()
        async with self._lock:
            if self._monitor is not None:
                await self._monitor.close()
                self._monitor = None
