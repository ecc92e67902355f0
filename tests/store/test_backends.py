"""One contract for all backends: SQLite, JSON files, MongoDB."""

from __future__ import annotations

import json
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import pytest

from ropeway.errors import StoreUnavailable
from ropeway.store import Backend, Entry, make_backend
from ropeway.store.files import FilesBackend
from ropeway.store.sqlite import SqliteBackend
from tests.store.mongo import mongo_database


def entry(data: bytes, version: int, *, system: str = "PEPPER", topic: str = "cmd_vel", origin: str = "n") -> Entry:
    return Entry(system, topic, data, version, 1_700_000_000_000_000_000 + version, origin, "std_msgs/msg/String")


@pytest.fixture(params=["sqlite", "files", "mongo"])
def url(request: pytest.FixtureRequest, tmp_path: Path) -> Iterator[str]:
    if request.param == "sqlite":
        yield str(tmp_path / "values" / "store.sqlite")
    elif request.param == "files":
        yield f"{tmp_path}/values/"
    else:
        with mongo_database(tmp_path) as made:
            yield made


@pytest.fixture
def backend(url: str) -> Iterator[Backend]:
    made = make_backend(url)
    made.open()
    yield made
    made.close()


def test_keeps(backend: Backend, url: str) -> None:
    """What was written is there for the next who opens it, byte for byte."""
    values = [
        entry(b"0.0,0.0,0.0,0.0,0.0,0.0", 1),
        entry("größe ✓".encode(), 2, topic="text"),
        entry(bytes(range(256)), 3, system="ALICE", topic="binary"),
        entry(b"", 4, topic="empty"),
    ]
    backend.write(values, 0)
    backend.close()
    again = make_backend(url)
    again.open()
    assert sorted(again.load(), key=lambda e: e.version) == values
    again.close()


def test_names(backend: Backend) -> None:
    """Names that a file system or a database has other uses for are kept apart."""
    systems = ["A/B", "..", ".", "system.x", "$cmd", "a.b", "sys%2Ftem", "Ünï", "A B"]
    values = [entry(name.encode(), 7, system=name, topic=f"t/{name}.history") for name in systems]
    backend.write(values, 0)
    assert sorted(backend.load(), key=lambda e: e.system) == sorted(values, key=lambda e: e.system)


@pytest.mark.parametrize("name", [":" * 100, "\u6f22" * 60, "\u6f22" * 66, "/" * 200, "." * 200])
def test_long_names(backend: Backend, name: str) -> None:
    """Names of up to 200 bytes are kept, however long they are as a file system has them, and told apart."""
    if backend.url.startswith("mongodb"):
        pytest.skip("names of collections are shorter there")
    others = [entry(b"good", 1), *(entry(bytes([n]), 1, system=name, topic=name[:-1] + str(n)) for n in range(3))]
    assert not backend.write([*others, entry(b"first", 1, system=name, topic=name)], 2)
    assert not backend.write([entry(b"second", 2, system=name, topic=name)], 2)
    assert {(e.system, e.topic, e.data) for e in backend.load()} == {
        *((e.system, e.topic, e.data) for e in others),
        (name, name, b"second"),
    }
    assert [e.data for e in backend.history((name, name))] == [b"first"]
    backend.remove([(name, name)])
    assert len(backend.load()) == len(others)


def test_bad_entries(backend: Backend) -> None:
    """What a backend can never keep is returned with its reason; the rest of the batch is kept."""
    bad = (
        entry(b"bad", 1 << 70, topic="bad") if not isinstance(backend, FilesBackend) else entry(b"", 1, origin="\ud800")
    )
    bad = replace(bad, topic="bad")
    assert list(backend.write([entry(b"1", 1, topic="a"), bad, entry(b"2", 1, topic="b")], 0)) == [bad.key]
    assert sorted(e.topic for e in backend.load()) == ["a", "b"]


def test_private(tmp_path: Path) -> None:
    """A store is made so that only its owner may read it."""
    backend = make_backend(str(tmp_path / "private.sqlite"))
    backend.open()
    backend.write([entry(b"1", 1)], 0)
    assert {path.stat().st_mode & 0o077 for path in tmp_path.glob("private.sqlite*")} == {0}
    backend.close()


def test_last_wins(backend: Backend) -> None:
    """A later version replaces an earlier one, and an earlier one replaces nothing, in one write or in several."""
    backend.write([entry(b"1", 1), entry(b"5", 5)], 0)
    backend.write([entry(b"3", 3)], 0)
    assert [e.data for e in backend.load()] == [b"5"]


def test_ties(backend: Backend) -> None:
    """Of two values of one version the greater origin's is the last, whichever comes first."""
    backend.write([entry(b"b", 5, origin="b")], 0)
    backend.write([entry(b"a", 5, origin="a")], 0)
    backend.write([entry(b"c", 5, origin="c")], 0)
    assert [e.data for e in backend.load()] == [b"c"]


def test_history(backend: Backend) -> None:
    """The values before the last are kept up to the depth, newest first, late ones among them."""
    for version in (1, 2, 3, 5, 4):
        backend.write([entry(str(version).encode(), version)], 3)
    assert [e.data for e in backend.load()] == [b"5"]
    assert [e.data for e in backend.history(("PEPPER", "cmd_vel"))] == [b"4", b"3", b"2"]


def test_history_of_one_write(backend: Backend) -> None:
    """Several values of one topic in one write become history in their order."""
    backend.write([entry(str(v).encode(), v) for v in range(1, 6)], 2)
    assert [e.data for e in backend.history(("PEPPER", "cmd_vel"))] == [b"4", b"3"]


def test_written_twice(backend: Backend) -> None:
    """The same entry again changes nothing and becomes no history."""
    backend.write([entry(b"1", 1)], 2)
    backend.write([entry(b"1", 1)], 2)
    assert [e.data for e in backend.load()] == [b"1"]
    assert backend.history(("PEPPER", "cmd_vel")) == []


def test_removes(backend: Backend) -> None:
    """A topic that is removed is gone with its history; others stay."""
    backend.write([entry(b"1", 1), entry(b"2", 2), entry(b"x", 1, topic="other")], 2)
    backend.remove([("PEPPER", "cmd_vel"), ("NOBODY", "nothing")])
    assert [e.topic for e in backend.load()] == ["other"]
    assert backend.history(("PEPPER", "cmd_vel")) == []


def test_closed(url: str, tmp_path: Path) -> None:
    """A place that cannot be had is told with its name and no traceback."""
    (tmp_path / "blocked").write_bytes(b"no directory and no database" * 100)
    bad = {
        "mongodb": "mongodb://user:secret@127.0.0.1:9/x",
        "values/": str(tmp_path / "blocked" / "inside") + "/",
        "store.s": str(tmp_path / "blocked"),
    }
    where = next(bad[key] for key in bad if key in url)
    backend = make_backend(where)
    with pytest.raises(StoreUnavailable) as told:
        backend.open()
    assert "secret" not in str(told.value)
    backend.close()


def test_full_disk(tmp_path: Path) -> None:
    """A full disk is told in words, costs nothing that was kept, and is overcome by itself."""
    backend = SqliteBackend(str(tmp_path / "s.sqlite"))
    backend.open()
    backend.write([entry(b"kept", 1)], 0)
    assert backend._db is not None
    (pages,) = backend._db.execute("PRAGMA page_count").fetchone()
    backend._db.execute(f"PRAGMA max_page_count = {pages}")
    with pytest.raises(StoreUnavailable, match="the disk is full"):
        backend.write([entry(b"x" * 100_000, 2, topic="big"), entry(b"later", 2)], 0)
    assert [e.data for e in backend.load()] == [b"kept"]
    backend._db.execute("PRAGMA max_page_count = 1000000")
    backend.write([entry(b"later", 2)], 0)
    assert [e.data for e in backend.load()] == [b"later"]
    backend.close()


def test_not_a_store(tmp_path: Path) -> None:
    """A file that is something else is left alone, and told."""
    path = tmp_path / "s.sqlite"
    path.write_bytes(b"something else" * 1000)
    with pytest.raises(StoreUnavailable, match="move it away"):
        make_backend(str(path)).open()
    assert path.read_bytes() == b"something else" * 1000


@pytest.mark.parametrize(
    "text",
    ["[" * 5000, '{"version": 1e999}', '{"version": 1e3}', '{"version": 9223372036854775808}', '{"base64": 5}', "null"],
)
def test_one_bad_file_fails_alone(tmp_path: Path, text: str) -> None:
    """A file that is none of ours, or whose numbers are none, is left alone, and the others are read."""
    backend = make_backend(f"{tmp_path}/values/")
    backend.open()
    backend.write([entry(b"x", 1), entry(b"y", 2, topic="odom")], 0)
    (path,) = tmp_path.glob("values/*/cmd_vel.json")
    told = json.loads(path.read_text())
    path.write_text(json.dumps(told)[:-1] + ", " + text[1:] if text.startswith("{") else text)
    assert [each.topic for each in backend.load()] == ["odom"]
    backend.close()
