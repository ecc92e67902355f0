"""Hands over messages that a value from elsewhere becomes: at once, or some time after each other.

Nodes and devices tell values in forms of which one may become several messages, such as a command and its end.
"""

from __future__ import annotations

import asyncio
import time
from collections.abc import Callable, Hashable, Sequence
from typing import Generic, Protocol, TypeVar

from ropeway.graph.base import Sample, SampleCallback
from ropeway.graph.host import Host
from ropeway.graph.parts import SubscriptionBase
from ropeway.qos import QoS
from ropeway.types.forms import Timed

__all__ = ["TimedHost", "TimedSubscription"]


class TimedHost(Host, Protocol):
    """A graph whose subscriptions hand messages over later."""

    loop: asyncio.AbstractEventLoop


H = TypeVar("H", bound=TimedHost)
S = TypeVar("S", bound=Hashable)


class TimedSubscription(SubscriptionBase[H], Generic[H, S]):
    """A topic whose messages come from sources ``S``; what is new of a source replaces what was still to come of it."""

    def __init__(self, graph: H, topic: str, type: str, qos: QoS | None, callback: SampleCallback) -> None:
        super().__init__(graph, topic, type, qos, callback)
        self._batch: list[Sample] = []
        self._scheduled = False
        self._timers: dict[S, list[asyncio.TimerHandle]] = {}

    def _came(self, source: S, sample: Sample) -> None:
        """Note a message that is handed over now."""
        raise NotImplementedError

    def _hand_over(self, source: S, messages: Sequence[Timed], make: Callable[[bytes], Sample]) -> None:
        """Hand over the messages of a value, each when its time has come, in the next turn of the loop."""
        for timer in self._timers.pop(source, ()):
            timer.cancel()
        for delay_s, payload in messages:
            sample = make(payload)
            if delay_s:
                timer = self._graph.loop.call_later(delay_s, self._later, source, sample)
                self._timers.setdefault(source, []).append(timer)
            else:
                self._add(source, sample)

    def _later(self, source: S, sample: Sample) -> None:
        sample.stamp_ns = sample.seq = time.time_ns()
        self._add(source, sample)

    def _add(self, source: S, sample: Sample) -> None:
        self._came(source, sample)
        self._batch.append(sample)
        if not self._scheduled:
            self._scheduled = True
            self._graph.loop.call_soon(self._flush)

    def _flush(self) -> None:
        self._scheduled = False
        batch, self._batch = self._batch, []
        self.deliver(batch)

    def _drop_timers(self) -> None:
        """Hand over nothing that was to come later."""
        for timers in self._timers.values():
            for timer in timers:
                timer.cancel()
        self._timers.clear()
