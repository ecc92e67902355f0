"""ropeway.graph.timed_messages: messages that a value becomes, at once and later."""

from __future__ import annotations

import asyncio
from collections import Counter
from collections.abc import Sequence
from typing import Any

import pytest

from ropeway.graph.base import Sample
from ropeway.graph.timed_messages import TimedSubscription
from tests.support.until import until

pytestmark = pytest.mark.jumping


class Graph:
    """What a subscription knows of its graph."""

    name = "here"

    def __init__(self) -> None:
        self.loop = asyncio.get_running_loop()
        self.drops: Counter[Any] = Counter()

    def guard(self, topic: str, callback: Any, value: Any) -> None:
        callback(value)


class Reading(TimedSubscription[Graph, str]):
    """A subscription that notes what is handed over, and when it is stopped."""

    def __init__(self, graph: Graph) -> None:
        self.came: list[tuple[str, bytes]] = []
        self.batches: list[list[bytes]] = []
        super().__init__(graph, "/t", "std_msgs/msg/String", None, self._heard)

    def _heard(self, batch: Sequence[Sample]) -> None:
        self.batches.append([bytes(sample.payload) for sample in batch])

    def _came(self, source: str, sample: Sample) -> None:
        self.came.append((source, bytes(sample.payload)))

    def value(self, source: str, *messages: tuple[float, bytes]) -> None:
        self._hand_over(source, messages, lambda payload: Sample(payload, self.type, 1, bytes(16), 1))

    def stop(self) -> None:
        self._drop_timers()


async def test_what_is_new_replaces_what_was_to_come() -> None:
    """Messages of one turn are one batch; later ones come in time, unless something new of their source came before."""
    reading = Reading(Graph())
    reading.value("a", (0.0, b"1"), (5.0, b"never"))
    reading.value("b", (0.0, b"2"), (1.0, b"3"))
    reading.value("a", (0.0, b"4"))
    await until(lambda: len(reading.batches) == 2)
    assert reading.batches == [[b"1", b"2", b"4"], [b"3"]]
    assert reading.came == [("a", b"1"), ("b", b"2"), ("a", b"4"), ("b", b"3")]


async def test_what_is_stopped_hands_over_nothing_later() -> None:
    """After its timers were dropped nothing comes."""
    reading = Reading(Graph())
    reading.value("a", (1.0, b"1"))
    reading.stop()
    reading.value("b", (2.0, b"2"))
    await until(lambda: reading.batches)
    assert reading.batches == [[b"2"]]
