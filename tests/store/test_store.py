from __future__ import annotations

import asyncio
import threading
import time
from collections.abc import AsyncIterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import pymongo
import pytest

from ropeway import aio
from ropeway.errors import StoreUnavailable, ValueRefused
from ropeway.store import Change, Entry, Key, Store, StoreLimits, Versions, default_path, make_backend, make_mirror
from tests.store.mongo import MongoServer
from tests.support.until import PATIENCE_S, until


class Flaky:
    """A backend in memory that can be told to fail, and to wait."""

    def __init__(self) -> None:
        self.url = "flaky"
        self.rows: dict[Key, Entry] = {}
        self.fail = ""
        self.writes: list[int] = []
        self.gate = threading.Event()
        self.gate.set()

    def _check(self) -> None:
        if self.fail:
            raise StoreUnavailable(self.url, self.fail)

    def open(self) -> None:
        self._check()

    def load(self) -> list[Entry]:
        self._check()
        return list(self.rows.values())

    def write(self, entries: list[Entry], depth: int) -> dict[Key, str]:
        self.gate.wait(PATIENCE_S)
        self._check()
        self.writes.append(len(entries))
        for entry in entries:
            before = self.rows.get(entry.key)
            if before is None or before.order < entry.order:
                self.rows[entry.key] = entry
        return {}

    def remove(self, keys: list[Key]) -> None:
        self._check()
        for key in keys:
            self.rows.pop(key, None)

    def history(self, key: Key) -> list[Entry]:
        return []

    def close(self) -> None:
        pass


class FlakyMirror(Flaky):
    """A database elsewhere, of which ``gone`` and ``news`` are what others changed."""

    follows, pause_s = "as told", 0.01

    def __init__(self) -> None:
        super().__init__()
        self.url = "mirror"
        self.news: list[Entry] = []
        self.gone: list[Key] = []
        self.looked: list[Key] = []

    def find(self, key: Key) -> tuple[Entry | None, bool]:
        self._check()
        self.looked.append(key)
        return self.rows.get(key), any(system == key[0] for system, _ in self.rows)

    def changes(self) -> Change:
        self._check()
        news, self.news, gone, self.gone = self.news, [], self.gone, []
        return Change(news, gone, min((e.stamp_ns for e in news if not e.version), default=time.time_ns()))


def fault_of(store: Store) -> str:
    return str(store.status()["mirror"]["fault"])


class Told:
    def __init__(self) -> None:
        self.tokens: list[Any] = []
        self.errors: list[Any] = []

    def kept(self, tokens: list[Any], error: StoreUnavailable | None) -> None:
        (self.tokens if error is None else self.errors).extend(tokens)


def entry(data: bytes, version: int, *, system: str = "PEPPER", topic: str = "cmd_vel", origin: str = "n") -> Entry:
    return Entry(system, topic, data, version, version * 1000, origin)


@pytest.fixture
async def flaky() -> Flaky:
    return Flaky()


@pytest.fixture
async def store(flaky: Flaky) -> AsyncIterator[Store]:
    made = Store(flaky)
    await made.open()
    yield made
    await made.close()


async def test_readable_at_once(store: Store, flaky: Flaky) -> None:
    """A value is readable at once, and whoever asked is told when it is kept."""
    flaky.gate.clear()
    told = Told()
    store.put(entry(b"1", 1), told, "first")
    value = store.get("PEPPER", "cmd_vel")
    assert value is not None
    assert value.data == b"1"
    assert told.tokens == []
    flaky.gate.set()
    await until(lambda: told.tokens == ["first"])
    assert flaky.rows[("PEPPER", "cmd_vel")].data == b"1"


async def test_groups(store: Store, flaky: Flaky) -> None:
    """What comes while the backend writes is written in one group, the last of each topic only."""
    flaky.gate.clear()
    told = Told()
    store.put(entry(b"0", 1), told, 0)
    await asyncio.sleep(0.05)
    for version in range(2, 102):
        store.put(entry(b"x", version), told, version)
    flaky.gate.set()
    await until(lambda: len(told.tokens) == 101)
    assert flaky.writes == [1, 1]


async def test_stale(store: Store) -> None:
    """Nothing older overwrites a newer value; the same one again is welcome."""
    store.put(entry(b"2", 2))
    with pytest.raises(ValueRefused) as refused:
        store.put(entry(b"1", 1))
    assert refused.value.code == "stale"
    assert store.put(entry(b"2", 2)) is False
    assert store.refused["stale"] == 1


async def test_limits(flaky: Flaky) -> None:
    """Values too big, too many or too much together are refused with the limit, and counted."""
    store = Store(flaky, limits=StoreLimits(max_value_bytes=10, max_values=3, max_bytes=25))
    await store.open()
    for topic in ("a", "b"):
        store.put(entry(b"x" * 10, 1, topic=topic))
    codes = []
    for data, topic in ((b"x" * 11, "a"), (b"x" * 6, "c"), (b"x", "c"), (b"x", "d"), (b"", ""), (b"", "a\n")):
        try:
            store.put(entry(data, 2, topic=topic))
        except ValueRefused as refused:
            codes.append(refused.code)
    assert codes == ["too-big", "full", "full", "name", "name"]
    await store.close()


async def test_backend_fails(store: Store, flaky: Flaky, caplog: pytest.LogCaptureFixture) -> None:
    """While the backend fails values are served and whoever asks is told so; when it is back all are kept."""
    told = Told()
    flaky.fail = "the disk is full"
    store.put(entry(b"1", 1), told, 1)
    await until(lambda: told.errors == [1])
    assert store.status()["fault"] == "flaky: the disk is full"
    store.put(entry(b"2", 2, topic="other"), told, 2)
    kept = store.get("PEPPER", "cmd_vel")
    assert kept is not None
    flaky.fail = ""
    await until(lambda: len(flaky.rows) == 2)
    await until(lambda: store.status()["fault"] == "")
    assert caplog.text.count("values are not kept") == 1


async def test_backend_fails_unforeseen(store: Store, flaky: Flaky, monkeypatch: pytest.MonkeyPatch) -> None:
    """Whatever a backend raises is a fault of the store that is told, and got over."""
    told = Told()
    with monkeypatch.context() as patch:
        patch.setattr(flaky, "write", lambda *_: 1 // 0)
        store.put(entry(b"1", 1), told, 1)
        await until(lambda: told.errors == [1])
        assert store.status()["fault"].startswith("flaky: ZeroDivisionError")
    await until(lambda: len(flaky.rows) == 1)
    await until(lambda: store.status()["fault"] == "")


async def test_one_node_cannot_be_told(store: Store) -> None:
    """A publisher that cannot be told that its value is kept costs the others nothing."""

    class Deaf:
        def kept(self, tokens: list[Any], error: StoreUnavailable | None) -> None:
            raise RuntimeError("its connection is gone")

    told = Told()
    store.put(entry(b"1", 1), Deaf(), 1)
    store.put(entry(b"2", 1, topic="other"), told, 2)
    await until(lambda: told.tokens == [2])


async def test_mirror(flaky: Flaky) -> None:
    """A mirror that is away at the start gets everything when it comes, and what is later there comes here."""
    mirror = FlakyMirror()
    mirror.fail = "is away"
    mirror.rows[("PEPPER", "theirs")] = entry(b"theirs", 9, topic="theirs")
    mirror.rows[("PEPPER", "old")] = entry(b"old", 1, topic="old")
    store = Store(flaky, mirror=mirror)
    await store.open()
    changes: list[Any] = []
    store.on_change.append(changes.append)
    store.put(entry(b"new", 5, topic="old"))
    store.put(entry(b"1", 1))
    await until(lambda: "is away" in fault_of(store))
    await until(lambda: store.status()["mirror"]["waiting"] == 2)
    mirror.fail = ""
    await until(lambda: len(mirror.rows) == 3 and not fault_of(store))
    assert mirror.rows[("PEPPER", "old")].data == b"new"
    theirs = store.get("PEPPER", "theirs")
    assert theirs is not None
    assert theirs in changes
    mirror.fail = "is away again"
    store.put(entry(b"2", 2))
    await until(lambda: "again" in fault_of(store))
    mirror.fail = ""
    await until(lambda: mirror.rows[("PEPPER", "cmd_vel")].data == b"2")
    await store.remove("PEPPER", "cmd_vel")
    await until(lambda: ("PEPPER", "cmd_vel") not in mirror.rows)
    await store.close()


async def test_real_mirror(tmp_path: Path) -> None:
    """A server starts and serves without its MongoDB, catches up when it returns, and loses nothing when it dies."""
    if MongoServer.program() is None:
        pytest.skip("needs mongod, or the ferretdb that .ci/run builds with Go")
    server = MongoServer(tmp_path / "mongo")
    store = Store(make_backend(str(tmp_path / "s.sqlite")), mirror=make_mirror(server.url))
    await store.open()
    try:
        store.put(entry(b"1", 1))
        await until(lambda: "does not answer" in fault_of(store))
        await asyncio.to_thread(server.start)
        await until(lambda: not fault_of(store) and not store.status()["mirror"]["waiting"])
        other = make_mirror(server.url)
        await asyncio.to_thread(other.open)
        assert [e.data for e in await asyncio.to_thread(other.load)] == [b"1"]
        await asyncio.to_thread(server.stop)
        store.put(entry(b"2", 2))
        await until(lambda: fault_of(store))
        await asyncio.to_thread(server.start)
        await until(lambda: not fault_of(store) and not store.status()["mirror"]["waiting"])
        assert [e.data for e in await asyncio.to_thread(other.load)] == [b"2"]
        other.close()
    finally:
        await store.close()
        server.stop()


async def test_follows_the_mirror(flaky: Flaky) -> None:
    """What others write to the mirror, or take away, is so here: with a version or without, newer values here first."""
    mirror = FlakyMirror()
    store = Store(flaky, mirror=mirror)
    await store.open()
    try:
        await until(lambda: not fault_of(store))

        def unversioned(data: bytes, topic: str = "free") -> Entry:
            return Entry("PEPPER", topic, data, 0, time.time_ns(), "mongodb")

        async def served(topic: str, data: bytes) -> None:
            await until(lambda: (e := store.get("PEPPER", topic)) is not None and e.data == data)

        mirror.news = [unversioned(b"1"), entry(b"given", 7, topic="versioned")]
        await served("free", b"1")
        await served("versioned", b"given")
        mirror.news = [unversioned(b"2"), entry(b"late", 6, topic="versioned")]
        await served("free", b"2")
        await store.settled()
        await until(lambda: ("PEPPER", "versioned") in mirror.rows and not store.status()["mirror"]["waiting"])
        mirror.news = [unversioned(b"3", "versioned")]
        await served("versioned", b"3")
        await store.settled()
        assert not mirror.rows.keys() - {("PEPPER", "versioned")}  # only what was older there was brought over
        before = unversioned(b"before", "own")
        store.put(entry(b"own", store.versions.next(), topic="own"))
        await until(lambda: ("PEPPER", "own") in mirror.rows)
        mirror.news = [before]
        mirror.gone = [("PEPPER", "free")]
        await until(lambda: store.get("PEPPER", "free") is None)
        await served("own", b"own")
    finally:
        await store.close()


async def test_looks_further(flaky: Flaky) -> None:
    """A value that is not here is looked up in the mirror, and one that is not there either is not at once again."""
    mirror = FlakyMirror()
    store = Store(flaky, mirror=mirror)
    assert not store.may_find("PEPPER", "x")
    await store.open()
    try:
        await until(lambda: store.may_find("PEPPER", "x"))
        mirror.rows["PEPPER", "x"] = entry(b"there", 3, topic="x")
        assert await store.find("PEPPER", "x")
        found = store.get("PEPPER", "x")
        assert found is not None
        assert found.data == b"there"
        assert await store.find("PEPPER", "y")
        assert not store.may_find("PEPPER", "y")
        assert not await store.find("NOBODY", "y")
        assert mirror.looked == [("PEPPER", "x"), ("PEPPER", "y"), ("NOBODY", "y")]
        mirror.fail = "is away"
        assert not await store.find("NOBODY", "z")
        await until(lambda: not store.may_find("NOBODY", "w"))
    finally:
        await store.close()


async def test_documents_of_others(tmp_path: Path) -> None:
    """Documents that a program inserts, changes and deletes in MongoDB are served so, and nodes write over them."""
    if MongoServer.program() is None:
        pytest.skip("needs mongod, or the ferretdb that .ci/run builds with Go")
    server = MongoServer(tmp_path / "mongo")
    await asyncio.to_thread(server.start)
    client: pymongo.MongoClient[dict[str, Any]] = pymongo.MongoClient(server.url)
    pepper = client["ropeway"]["PEPPER"]
    store = Store(make_backend(str(tmp_path / "s.sqlite")), mirror=make_mirror(server.url))
    await store.open()

    async def served(topic: str, data: bytes) -> None:
        await until(lambda: (e := store.get("PEPPER", topic)) is not None and e.data == data)

    try:
        await until(lambda: not fault_of(store))
        inserted: list[dict[str, Any]] = [
            {"_id": "a", "data": "1"},
            {"_id": "b", "data": "2", "version": 3},
            {"_id": "c", "data": {"x": 1}},
        ]
        await asyncio.to_thread(pepper.insert_many, [*inserted, {"_id": "none"}])
        assert await store.find("PEPPER", "a")
        await served("a", b"1")
        await served("b", b"2")
        await served("c", b'{"x": 1}')
        assert store.get("PEPPER", "none") is None
        await asyncio.to_thread(pepper.update_one, {"_id": "a"}, {"$set": {"data": "10"}})
        await asyncio.to_thread(pepper.delete_one, {"_id": "c"})
        await served("a", b"10")
        await until(lambda: store.get("PEPPER", "c") is None)
        known = store.get("PEPPER", "a")
        assert known is not None
        store.put(entry(b"node", store.versions.next(known.version), topic="a"))

        async def there(topic: str) -> Any:
            return ((await asyncio.to_thread(pepper.find_one, {"_id": topic})) or {}).get("data")

        async with aio.timeout(PATIENCE_S):
            while await there("a") != "node":
                await asyncio.sleep(0.05)
        await asyncio.to_thread(pepper.update_one, {"_id": "a"}, {"$set": {"data": "program"}})
        await served("a", b"program")
        assert await there("a") == "program"
        assert await there("b") == "2"
    finally:
        await store.close()
        client.close()
        server.stop()


async def test_age(flaky: Flaky) -> None:
    """A value that is too old is not given, and is forgotten."""
    now = 10_000_000_000
    store = Store(flaky, limits=StoreLimits(max_age_s=1.0), clock_ns=lambda: now)
    await store.open()
    store.put(Entry("A", "t", b"1", 1, now))
    assert store.get("A", "t") is not None
    now += 1_500_000_000
    assert store.get("A", "t") is None
    assert store.entries() == []
    await until(lambda: not flaky.rows)
    await store.close()


async def test_patterns(store: Store) -> None:
    """Values are listed by patterns, in the order of their names."""
    for system in ("B", "A"):
        for topic in ("odom", "battery"):
            store.put(entry(b"", 1, system=system, topic=topic))
    assert [e.key for e in store.entries("A", "odom")] == [("A", "odom")]
    assert store.entries("A", "nothing") == []
    assert [e.key for e in store.entries("A", "*")] == [("A", "battery"), ("A", "odom")]
    assert [e.key for e in store.entries("*", "odom")] == [("A", "odom"), ("B", "odom")]
    assert store.has_system("A")
    await store.remove("A", "odom")
    await store.remove("A", "battery")
    assert not store.has_system("A")


async def test_history(tmp_path: Path) -> None:
    """With a depth the values before the last can be had; one that comes late is among them, and still refused."""
    store = Store(make_backend(str(tmp_path / "h.sqlite")), limits=StoreLimits(history=2))
    await store.open()
    for version in (1, 2, 4):
        store.put(entry(str(version).encode(), version))
    with pytest.raises(ValueRefused):
        store.put(entry(b"3", 3))
    assert [e.data for e in await store.history("PEPPER", "cmd_vel")] == [b"3", b"2"]
    await store.close()


async def test_restart(tmp_path: Path) -> None:
    """Values are there after a restart, and versions go on where they were."""
    path = str(tmp_path / "r.sqlite")
    store = Store(make_backend(path))
    await store.open()
    store.put(entry(b"1", time.time_ns() // 1000 + 3_600_000_000))
    await store.close()
    store = Store(make_backend(path))
    await store.open()
    value = store.get("PEPPER", "cmd_vel")
    assert value is not None
    assert store.versions.next() > value.version
    await store.close()


async def test_a_version_from_a_far_future(tmp_path: Path) -> None:
    """A version that lies far ahead is refused: none could follow it."""
    store = Store(make_backend("memory:"))
    await store.open()
    with pytest.raises(ValueRefused, match="too far in the future"):
        store.put(replace(entry(b"poison", 1), version=(1 << 62) - 1))
    store.put(replace(entry(b"good", 1), version=store.versions.next()))
    await store.close()


@pytest.mark.parametrize("name", ["v.sqlite", "v/"])
async def test_a_store_with_a_version_from_a_far_future(tmp_path: Path, name: str) -> None:
    """A value that is kept with such a version counts as written now, so that later ones outrank it, for good."""
    path = str(tmp_path / name) + ("/" if name.endswith("/") else "")
    backend = make_backend(path)
    backend.open()
    poison = replace(entry(b"poison", 1), version=(1 << 62) - 1)
    assert not backend.write([poison, entry(b"other", 7, topic="other")], 0)
    backend.close()
    for data in (b"1", b"2"):
        store = Store(make_backend(path))
        await store.open()
        known = store.get("PEPPER", "cmd_vel")
        assert known is not None
        store.put(replace(entry(data, 1), version=store.versions.next(known.version)))
        assert await store.settled()
        await store.close()
    backend.open()
    assert {found.topic: found.data for found in backend.load()} == {"cmd_vel": b"2", "other": b"other"}
    backend.close()


async def test_one_bad_entry_fails_alone() -> None:
    """An entry that a backend can never keep costs the others of its batch nothing; who wrote it is told."""

    class Picky(Flaky):
        def write(self, entries: list[Entry], depth: int) -> dict[Key, str]:
            super().write([entry for entry in entries if entry.topic != "bad"], depth)
            return {entry.key: "its name" for entry in entries if entry.topic == "bad"}

    backend, told = Picky(), Told()
    store = Store(backend)
    await store.open()
    store.put(entry(b"1", 1, topic="bad"), told, "bad")
    store.put(entry(b"2", 1, topic="good"), told, "good")
    await until(lambda: told.tokens and told.errors)
    assert (told.tokens, told.errors) == (["good"], ["bad"])
    assert store.refused["not-kept"] == 1
    assert not store.fault
    await store.close()


def test_versions() -> None:
    """Versions grow, also when the clock jumps back, and are later than what was seen."""
    now = 5_000_000
    versions = Versions(lambda: now)
    first = versions.next()
    assert first == 5_000
    now = 1_000_000
    assert versions.next() == 5_001
    assert versions.next(after=9_999) == 10_000


def test_default_path(monkeypatch: pytest.MonkeyPatch) -> None:
    """Without a path values are kept under the user's state directory, by the gateway's name."""
    monkeypatch.setenv("XDG_STATE_HOME", "/state")
    assert default_path("robot1") == "/state/ropeway/robot1.sqlite"
