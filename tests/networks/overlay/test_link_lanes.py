"""Packets that go by several links, one of which takes nothing."""

from __future__ import annotations

import threading
from collections.abc import Iterator

import pytest

from ropeway.errors import GraphUnavailable
from ropeway.limits import OVERLAY_LINK_WAITING_BYTES
from ropeway.networks.overlay.link_lanes import LinkLanes
from tests.support.until import PATIENCE_S


def always() -> bool:
    return True


class Stuck:
    """A link that takes nothing until it is let go."""

    def __init__(self) -> None:
        self.go, self.took = threading.Event(), threading.Semaphore(0)

    def put(self) -> None:
        self.go.wait(PATIENCE_S)
        self.took.release()


def unlinked() -> None:
    raise GraphUnavailable("overlay", "it is not open")


@pytest.fixture
def lanes() -> Iterator[LinkLanes]:
    made = LinkLanes()
    yield made
    made.close()


@pytest.fixture
def stuck() -> Iterator[Stuck]:
    made = Stuck()
    yield made
    made.go.set()


def test_one_takes_it(lanes: LinkLanes, stuck: Stuck) -> None:
    """A packet is put once one link has taken it; the other gets it when it can, in the order in which they came."""
    took: list[int] = []
    for number in range(3):
        lanes.put(4, 10, {"a": stuck.put, "b": lambda number=number: took.append(number)}, always)
    assert took == [0, 1, 2]
    stuck.go.set()
    assert all(stuck.took.acquire(timeout=PATIENCE_S) for _ in range(3))


def test_too_much_waits(lanes: LinkLanes, stuck: Stuck) -> None:
    """What waits for a link that takes nothing is bounded; copies beyond are left out there and counted."""
    took: list[int] = []
    for number in range(5):
        puts = {"a": stuck.put, "b": lambda number=number: took.append(number)}
        lanes.put(4, OVERLAY_LINK_WAITING_BYTES // 2, puts, always)
    assert took == [0, 1, 2, 3, 4]
    assert lanes.left_out == {"a": 2}


def test_none_takes_it(lanes: LinkLanes) -> None:
    """Where no link takes a packet, what the last one said is raised; one that fails does no harm otherwise."""
    lanes.put(4, 10, {"a": unlinked, "b": lambda: None}, always)
    with pytest.raises(GraphUnavailable, match="not open"):
        lanes.put(4, 10, {"a": unlinked, "b": unlinked}, always)


def test_no_longer_waited_for(lanes: LinkLanes, stuck: Stuck) -> None:
    """A link that takes nothing is waited for until another one comes into use."""
    asked = []

    def waits() -> bool:
        asked.append(True)
        return len(asked) < 3

    lanes.put(4, 10, {"a": stuck.put}, waits)
    assert len(asked) == 3


def test_nobody_waits(lanes: LinkLanes) -> None:
    """What is put soon goes before what is put later, and nobody waits for it, or hears that it failed."""
    order: list[int] = []
    lanes.put_soon(4, 10, "a", unlinked)
    lanes.put_soon(4, 10, "a", lambda: order.append(1))
    lanes.put(4, 10, {"a": lambda: order.append(2)}, always)
    assert order == [1, 2]
