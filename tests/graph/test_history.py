"""ropeway.graph.history."""

from __future__ import annotations

import pytest

from ropeway.graph.base import Sample
from ropeway.graph.history import History
from ropeway.qos import QoS


class Clock:
    def __init__(self) -> None:
        self.now = 0

    def __call__(self) -> int:
        return self.now


def kept(history: History) -> list[int]:
    return [sample.seq for sample in history.replay()]


def fill(history: History, count: int, size: int = 10) -> None:
    for seq in range(count):
        history.add(Sample(bytes(size), "", seq, b"", seq))


@pytest.mark.parametrize(
    ("qos", "expected"),
    [
        (QoS(), []),
        (QoS(durability="transient_local", depth=3), [7, 8, 9]),
        (QoS(durability="transient_local", depth=0), [9]),
        (QoS(durability="transient_local", history="keep_all"), list(range(10))),
    ],
)
def test_depth(qos: QoS, expected: list[int]) -> None:
    """As many messages are kept as the profile says, the newest, and none of a volatile topic."""
    history = History(qos)
    fill(history, 10)
    assert kept(history) == expected
    assert kept(history) == expected


def test_lifespan() -> None:
    """What is older than the lifespan is not given to late joiners, and takes no memory."""
    clock = Clock()
    history = History(QoS(durability="transient_local", depth=100, lifespan_s=5e-9), clock=clock)
    fill(history, 10)
    clock.now = 12
    assert kept(history) == [7, 8, 9]
    clock.now = 100
    assert kept(history) == []
    history.add(Sample(bytes(10), "", 1, b"", 1))
    assert history._bytes == 0


def test_bounded_in_bytes() -> None:
    """However deep, only so many bytes are kept; one message is, whatever its size."""
    history = History(QoS(durability="transient_local", history="keep_all"), limit_bytes=100)
    fill(history, 1000)
    assert kept(history) == list(range(990, 1000))
    history.add(Sample(bytes(1000), "", 0, b"", 5))
    assert kept(history) == [5]
