from __future__ import annotations

from collections.abc import AsyncIterator

import pytest

from ropeway.errors import ValueRefused
from ropeway.limits import PATTERNS_PER_NODE
from ropeway.networks.iort import space as module
from ropeway.networks.iort.space import MemberEndpoint, Space
from ropeway.store import Entry, Store, StoreLimits, make_backend


class Person:
    def __init__(self, node: str) -> None:
        self.node = node
        self.values: list[tuple[str, bool]] = []
        self.events: list[tuple[str, str, bool]] = []

    def value(self, entry: Entry, latest: bool) -> None:
        self.values.append((f"{entry.topic}={entry.data.decode()}", latest))

    def event(self, endpoint: MemberEndpoint, there: bool) -> None:
        self.events.append((endpoint.kind, endpoint.topic, there))


@pytest.fixture
async def space() -> AsyncIterator[Space]:
    store = Store(make_backend("memory:"), limits=StoreLimits(history=3))
    await store.open()
    made = Space(store)
    yield made
    made.close()
    await store.close()


async def test_everybody_else_hears(space: Space) -> None:
    """A value goes to all who subscribed but its publisher, once, however many patterns fit."""
    one, two = Person("one"), Person("two")
    for person in (one, two):
        space.join(person)
        space.subscribe(person, "A", "*", latest=False)
        space.subscribe(person, "A", "x", latest=False)
    space.publish(one, "A", "x", b"1", origin="one")
    assert one.values == []
    assert two.values == [("x=1", False)]
    space.unsubscribe(two, "A", "x")
    space.publish(one, "A", "x", b"2", origin="one")
    space.unsubscribe(two, "A", "*")
    space.publish(one, "A", "x", b"3", origin="one")
    assert two.values == [("x=1", False), ("x=2", False)]


async def test_latest(space: Space) -> None:
    """Who asks for it begins with the values that are there."""
    person = Person("late")
    space.join(person)
    space.publish(None, "A", "x", b"1", origin="o")
    space.publish(None, "A", "y", b"2", origin="o")
    space.subscribe(person, "A", "*")
    assert person.values == [("x=1", True), ("y=2", True)]


async def test_other_writers(space: Space) -> None:
    """What comes into the store by another way is heard, too."""
    person = Person("p")
    space.join(person)
    space.subscribe(person, "A", "x", latest=False)
    space.store.put(Entry("A", "x", b"mirror", 5, 5, "elsewhere"))
    assert person.values == [("x=mirror", False)]


async def test_versions(space: Space) -> None:
    """Live values take the version they come with, if it is later than what is there and not in the far future."""
    assert space.publish(None, "A", "x", b"1", origin="o", version=100).version == 100
    assert space.publish(None, "A", "x", b"2", origin="o", version=50).version > 100
    far = 1 << 60
    assert space.publish(None, "A", "x", b"3", origin="o", version=far).version < far
    with pytest.raises(ValueRefused):
        space.publish(None, "A", "x", b"4", origin="o", version=60, merge=True)
    kept = space.store.get("A", "x")
    assert kept is not None
    assert kept.data == b"3"


async def test_events(space: Space) -> None:
    """Who watches learns of what is there, and of what comes and goes, not of its own."""
    watcher, person = Person("watcher"), Person("person")
    space.join(person)
    space.advertise(person, "A", "early")
    space.join(watcher)
    space.watch(watcher)
    space.publish(person, "A", "x", b"1", origin="o")
    space.publish(person, "A", "x", b"2", origin="o")
    space.subscribe(watcher, "A", "x")
    space.subscribe(person, "A", "y")
    space.withdraw(person, "A", "early")
    space.leave(person)
    space.leave(person)
    assert watcher.events == [
        ("publisher", "early", True),
        ("publisher", "x", True),
        ("subscription", "y", True),
        ("publisher", "early", False),
        ("publisher", "x", False),
        ("subscription", "y", False),
    ]


async def test_patterns_are_bounded(space: Space) -> None:
    """A member has so many patterns and no more, and of so many characters; topics by name do not count."""
    person = Person("greedy")
    space.join(person)
    for number in range(PATTERNS_PER_NODE):
        space.subscribe(person, f"x{number}*", "y*")
        space.subscribe(person, "x", f"y{number}")
    space.subscribe(person, "x0*", "y*")
    with pytest.raises(ValueRefused, match="patterns at most"):
        space.subscribe(person, "one", "more*")
    space.unsubscribe(person, "x0*", "y*")
    with pytest.raises(ValueRefused, match="characters at most"):
        space.subscribe(person, "one", "*" * 300)
    space.subscribe(person, "one", "more*")


async def test_patterns_are_tried_once(space: Space) -> None:
    """Which patterns fit a topic is known after its first value, until there are other patterns."""
    reader, writer = Person("reader"), Person("writer")
    space.join(reader)
    space.join(writer)
    space.subscribe(reader, "A*", "t")
    space.publish(writer, "A", "t", b"1", origin="w")
    known = space._fitting["A", "t"]
    space.publish(writer, "A", "t", b"2", origin="w")
    assert space._fitting["A", "t"] is known
    space.subscribe(reader, "*", "t", latest=False)
    space.publish(writer, "A", "t", b"3", origin="w")
    assert len(space._fitting["A", "t"]) == 2
    space.leave(reader)
    space.publish(writer, "A", "t", b"4", origin="w")
    assert not space._fitting


async def test_endpoints_are_bounded(space: Space, monkeypatch: pytest.MonkeyPatch) -> None:
    """One member cannot have endpoints without end."""
    monkeypatch.setattr(module, "ENDPOINTS_PER_NODE", 3)
    person = Person("greedy")
    space.join(person)
    for topic in ("a", "b", "c", "a"):
        space.advertise(person, "A", topic)
    with pytest.raises(ValueRefused, match="3 topics at most"):
        space.subscribe(person, "A", "d")
    assert space.refused["full"] == 1


async def test_written_topics_are_bounded(space: Space, monkeypatch: pytest.MonkeyPatch) -> None:
    """One member cannot write values of names without end; what is refused is not in the store."""
    monkeypatch.setattr(module, "ENDPOINTS_PER_NODE", 2)
    monkeypatch.setattr(module, "BROUGHT_TOPICS_PER_NODE", 3)
    person, other = Person("greedy"), Person("other")
    space.join(person)
    space.join(other)
    for topic in ("a", "b", "a"):
        space.publish(person, "A", topic, b"1", origin="g")
    with pytest.raises(ValueRefused, match="2 topics at most"):
        space.publish(person, "A", "c", b"1", origin="g")
    assert space.store.get("A", "c") is None
    space.publish(person, "A", "d", b"1", origin="g", merge=True, version=1)
    with pytest.raises(ValueRefused, match="3 topics at most"):
        space.publish(person, "A", "e", b"1", origin="g", merge=True, version=1)
    assert space.store.get("A", "e") is None
    space.publish(other, "A", "e", b"1", origin="o")
    space.withdraw(person, "A", "d")
    space.withdraw(person, "A", "a")
    space.publish(person, "A", "c", b"1", origin="g")
    assert space.refused["full"] == 2
