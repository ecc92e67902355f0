"""Database files of rosbag2 that are cut short or odd."""

from __future__ import annotations

import sqlite3
from pathlib import Path

import pytest

from ropeway.errors import BagUnreadable
from ropeway.recording.bag import Bag
from ropeway.types import TypeRegistry

COUNT = 3000


def write(path: Path) -> Path:
    """A recording of texts as Foxy wrote it: without definitions."""
    codec = TypeRegistry().codec("std_msgs/msg/String")
    with sqlite3.connect(path) as db:
        db.execute("CREATE TABLE topics(id INTEGER PRIMARY KEY, name TEXT, type TEXT, serialization_format TEXT)")
        db.execute("CREATE TABLE messages(id INTEGER PRIMARY KEY, topic_id INTEGER, timestamp INTEGER, data BLOB)")
        db.execute("INSERT INTO topics VALUES (1, '/text', 'std_msgs/msg/String', 'cdr')")
        rows = ((1, 10**9 + n, codec.encode({"data": str(n)})) for n in range(COUNT))
        db.executemany("INSERT INTO messages(topic_id, timestamp, data) VALUES (?, ?, ?)", rows)
    db.close()
    return path


def test_the_first_schema(tmp_path: Path) -> None:
    """A database without profiles and definitions is played whole."""
    with Bag(write(tmp_path / "a.db3"), TypeRegistry()) as bag:
        assert (len(list(bag.records())), bag.notes) == (COUNT, [])


def test_cut_short(tmp_path: Path) -> None:
    """Of a database that is cut short what is whole is played, and it is told."""
    whole = write(tmp_path / "a.db3").read_bytes()
    (tmp_path / "cut.db3").write_bytes(whole[: len(whole) // 2])
    with Bag(tmp_path / "cut.db3", TypeRegistry()) as bag:
        times = [record.time_ns - 10**9 for record in bag.records()]
        assert times == sorted(times)
        assert COUNT // 4 < len(times) < COUNT
        assert bag.notes == ["it is cut short or damaged; what is whole is played"]


def test_messages_that_cannot_be_played_are_told(tmp_path: Path) -> None:
    """Messages of no topic, or without a time or bytes, are counted and told; the others are played."""
    with sqlite3.connect(write(tmp_path / "a.db3")) as db:
        insert = "INSERT INTO messages(topic_id, timestamp, data) VALUES (?, ?, ?)"
        odd = [(9, 1, b"\0\1\0\0"), (1, "soon", b"\0\1\0\0"), (1, None, b"\0\1\0\0"), (1, 5, "text"), (1, 6, None)]
        db.executemany(insert, odd)
    db.close()
    with Bag(tmp_path / "a.db3", TypeRegistry()) as bag:
        assert len(list(bag.records())) == COUNT
        assert bag.notes == [
            "4 of its messages have no time or no bytes, and are left out",
            "1 of its messages are of no topic that it names, and left out",
        ]


def test_another_database(tmp_path: Path) -> None:
    """A database of something else is refused as such."""
    with sqlite3.connect(tmp_path / "a.db3") as db:
        db.execute("CREATE TABLE other(id INTEGER)")
    db.close()
    with pytest.raises(BagUnreadable, match="not a rosbag2 recording"), Bag(tmp_path / "a.db3", TypeRegistry()):
        pass


def test_what_a_killed_recorder_left_in_the_journal_is_played(tmp_path: Path) -> None:
    """Messages that stand in the write-ahead log only are played, too."""
    db = sqlite3.connect(write(tmp_path / "a.db3"))
    db.execute("PRAGMA journal_mode=WAL")
    db.execute("PRAGMA wal_autocheckpoint=0")
    db.execute("INSERT INTO messages(topic_id, timestamp, data) VALUES (1, 1, x'00010000')")
    db.commit()
    with Bag(tmp_path / "a.db3", TypeRegistry()) as bag:
        assert len(list(bag.records())) == COUNT + 1
    db.close()
