"""ropeway.networks.iort.server.pushes."""

from __future__ import annotations

from collections import Counter

from ropeway.limits import NODE_WAITING_BYTES
from ropeway.networks.iort.server.pushes import Pushes
from ropeway.store import Entry


def entry(topic: str, data: bytes, version: int = 1) -> Entry:
    return Entry("PEPPER", topic, data, version, version, "n")


class Waiting:
    """What waits for a node, and how many values gave way to others."""

    def __init__(self) -> None:
        self.counts = Counter[str]()
        self.pushes = Pushes(lambda: self.counts.update(superseded=1))

    def taken(self) -> list[tuple[str, bytes, bool]]:
        """Take everything."""
        found = []
        while (each := self.pushes.take()) is not None:
            found.append((each[0].topic, each[0].data, each[1]))
        return found


def test_newest_of_each_topic() -> None:
    """Of each topic the newest value waits, and those in whose place it is are counted."""
    waiting = Waiting()
    for number in range(3):
        waiting.pushes.put(entry("pose", b"%d" % number), number == 0)
    waiting.pushes.put(entry("battery", b"79"), True)
    assert bool(waiting.pushes)
    assert waiting.pushes.bytes == 3
    assert sorted(waiting.taken()) == [("battery", b"79", True), ("pose", b"2", False)]
    assert waiting.counts["superseded"] == 2
    assert not waiting.pushes
    assert waiting.pushes.bytes == 0


def test_as_many_topics_as_there_is_room_for() -> None:
    """Where the values of many topics are too much together, those of the topics that came first are given up."""
    waiting = Waiting()
    half = NODE_WAITING_BYTES // 2
    for topic in ("first", "second", "third"):
        waiting.pushes.put(entry(topic, bytes(half)), False)
    assert waiting.pushes.bytes <= NODE_WAITING_BYTES
    assert sorted(topic for topic, _, _ in waiting.taken()) == ["second", "third"]
    assert waiting.counts["superseded"] == 1


def test_one_value_always_has_room() -> None:
    """A value that is larger than everything that may wait is sent all the same."""
    waiting = Waiting()
    waiting.pushes.put(entry("small", b"x"), False)
    waiting.pushes.put(entry("map", bytes(NODE_WAITING_BYTES + 1)), False)
    assert [(topic, len(data)) for topic, data, _ in waiting.taken()] == [("map", NODE_WAITING_BYTES + 1)]


def test_clear() -> None:
    """Nothing waits for a node that has left."""
    waiting = Waiting()
    waiting.pushes.put(entry("pose", b"1"), False)
    waiting.pushes.clear()
    assert not waiting.pushes
    assert waiting.taken() == []
    assert waiting.counts["superseded"] == 0
