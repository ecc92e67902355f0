"""Passes on the messages of a topic: the one place that does.

A route of the configuration has a passage, and so has each topic that a client of the rosbridge server publishes or
reads. A passage takes messages in batches through its steps, counts them, and gives them to its sink. Nothing else
meters a topic.
"""

from __future__ import annotations

from bisect import bisect_left
from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from typing import Any, Protocol

from ropeway.delivery.histogram import BOUNDS_NS, Histogram
from ropeway.delivery.meter import Meter
from ropeway.delivery.pipeline import Drop, Reason, Step
from ropeway.graph.base import Sample

__all__ = ["Keep", "Passage"]


class Keep(Protocol):
    """Keeps the last message of a topic over restarts."""

    def put(self, sample: Sample) -> None:
        """Keep a message that passed."""

    def last(self) -> Sample | None:
        """Return the message that passed last, with its original stamp."""


class Passage:
    """Passes messages on through ``steps`` to ``sink``; every drop is counted with its reason in ``drops``.

    Without a sink nobody asked for the topic. ``keep`` keeps the last message that passed. ``delays`` counts messages
    by their delay, with those of other passages that share it.
    """

    __slots__ = ("drops", "keep", "meter", "sink", "steps")

    def __init__(
        self,
        steps: Sequence[Step] = (),
        *,
        delays: Histogram | None = None,
        drops: Counter[Reason] | None = None,
        keep: Keep | None = None,
        sink: Callable[[Sample], None] | None = None,
    ) -> None:
        self.steps = steps
        self.meter = Meter(delays)
        self.drops: Counter[Reason] = Counter() if drops is None else drops
        self.keep = keep
        self.sink = sink

    def pass_on(self, batch: Sequence[Sample], *, held: bool = False) -> None:
        """Pass messages on, oldest first; ``held`` ones have been through the steps, one of which held them back."""
        if self.steps and not held:
            batch = self._through(batch)
        sink, meter, keep = self.sink, self.meter, self.keep
        if sink is None:
            self.drops[Drop.INACTIVE] += len(batch)
            return
        for sample in batch:
            meter.messages += 1
            meter.bytes += len(sample.payload)
            if sample.sent_ns:
                delay_ns = sample.stamp_ns - sample.sent_ns
                meter.delayed += 1
                meter.delay_ns += delay_ns
                delays = meter.delays
                (delays.counts or delays.begun())[bisect_left(BOUNDS_NS, delay_ns)] += 1
                if delay_ns > 0:
                    delays.sum_ns += delay_ns
            if keep is not None:
                keep.put(sample)
            sink(sample)

    def _through(self, batch: Sequence[Sample]) -> list[Sample]:
        passed = []
        for sample in batch:
            for step in self.steps:
                result = step(sample)
                if not isinstance(result, Sample):
                    if result is not None:
                        self.drops[result] += 1
                    break
                sample = result
            else:
                passed.append(sample)
        return passed

    def status(self, more_drops: Mapping[Any, int]) -> dict[str, Any]:
        """Return the figures as JSON, with what was dropped elsewhere on the way."""
        meter = self.meter
        drops = {**self.drops, **more_drops}
        return {
            "messages": meter.messages,
            "rate_hz": round(meter.rate_hz, 2),
            "bandwidth_bps": round(meter.rate_bps),
            "delay_ms": None if meter.delay_s is None else round(1e3 * meter.delay_s, 3),
            "drops": {reason.value: n for reason, n in drops.items() if n},
        }
