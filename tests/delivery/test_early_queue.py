"""ropeway.delivery.early_queue."""

from __future__ import annotations

from collections import Counter

from ropeway.delivery.early_queue import EarlyQueue
from ropeway.delivery.outbox import Lost
from ropeway.delivery.pipeline import Reason
from ropeway.graph.base import Sample


def sample(seq: int, size: int = 10) -> Sample:
    return Sample(bytes(size), "a/msg/B", 0, b"", seq)


def test_what_is_held_is_given_back_in_its_order() -> None:
    """Messages are held until they are taken, oldest first, and then nothing is held."""
    queue = EarlyQueue(Counter())
    for seq in (1, 2, 3):
        queue.hold(sample(seq))
    assert queue.bytes == 30
    assert [s.seq for s in queue.take()] == [1, 2, 3]
    assert (queue.bytes, queue.take()) == (0, [])


def test_the_oldest_make_room() -> None:
    """Beyond the limit the oldest are dropped and counted; a single message may be larger."""
    drops: Counter[Reason] = Counter()
    queue = EarlyQueue(drops, limit_bytes=25)
    for seq in (1, 2, 3):
        queue.hold(sample(seq))
    queue.hold(sample(4, 100))
    assert [s.seq for s in queue.take()] == [4]
    assert drops == {Lost.OVERFLOW: 3}
