"""ropeway.gateway.journal: what was changed, on disk before it counts."""

from __future__ import annotations

import sqlite3
import stat
import subprocess
import sys
import threading
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

from ropeway.errors import JournalError
from ropeway.gateway.journal import Journal, JournalEntry


@pytest.fixture
def journal(tmp_path: Path) -> Iterator[Journal]:
    """A journal of its own."""
    made = Journal(tmp_path / "state" / "robot.journal")
    yield made
    made.close()


def entry(etag: str = "e1", **more: Any) -> JournalEntry:
    return JournalEntry("ann", "unix:1", "apply", "/robot.json", "digest", etag, **more)


def test_what_came_up_is_remembered(journal: Journal) -> None:
    """An entry is pending until it is confirmed; only what came up is found as the last good one."""
    first = journal.begin(entry("e1", plan=({"action": "start"},)), {"n": 1})
    assert journal.last_up() is None
    journal.confirm(first.number)
    second = journal.begin(entry("e2"), {"n": 2})
    third = journal.begin(entry("e3"), {"n": 3})
    journal.fail(third.number, "no such port")
    last = journal.last_up()
    assert last is not None
    assert (last.number, journal.config(last), last.plan) == (first.number, {"n": 1}, ({"action": "start"},))
    assert [(e.number, e.state) for e in journal.history()] == [
        (third.number, "failed"),
        (second.number, "pending"),
        (first.number, "up"),
    ]
    assert journal.history(count=1, before=second.number)[0].number == first.number
    assert journal.entry(third.number).note == "no such port"
    assert journal.entry(99) is None
    assert stat.S_IMODE(journal.path.stat().st_mode) == 0o600


_KILLED = """
import os, sys
from pathlib import Path
from ropeway.gateway.journal import Journal, JournalEntry
journal = Journal(Path(sys.argv[1]))
number = 0
while True:
    number += 1
    entry = journal.begin(JournalEntry("ann", "x", "apply", "f", "d", f"e{number}"), {"n": number})
    journal.confirm(entry.number)
    os.write(1, b"%d\\n" % number)
"""


def test_kill_9(tmp_path: Path) -> None:
    """Killed at any moment, the journal has everything that was confirmed, and is sound."""
    path = tmp_path / "robot.journal"
    for _ in range(3):
        process = subprocess.Popen([sys.executable, "-c", _KILLED, str(path)], stdout=subprocess.PIPE)
        assert process.stdout is not None
        confirmed = [int(process.stdout.readline()) for _ in range(30)]
        process.kill()
        rest, _ = process.communicate()
        confirmed += [int(line) for line in rest.splitlines()]
        journal = Journal(path)
        assert journal.set_aside is None
        last = journal.last_up()
        assert last is not None
        assert journal.config(last)["n"] >= confirmed[-1]
        journal.close()


@pytest.mark.parametrize("where", ["head", "middle", "text"])
def test_damaged(tmp_path: Path, where: str) -> None:
    """A journal that is damaged is put aside, and a new one begun; it is never taken for good."""
    path = tmp_path / "robot.journal"
    journal = Journal(path)
    for number in range(50):
        journal.confirm(journal.begin(entry(f"e{number}", note="x" * 500), {"n": number, "text": "y" * 500}).number)
    journal.close()
    raw = bytearray(path.read_bytes())
    if where == "text":
        raw[:] = b"this is no database\n" * 100
    elif where == "head":
        raw[:40] = bytes(40)
    else:
        raw[4096:-4096] = bytes(len(raw) - 8192)
    path.write_bytes(raw)
    again = Journal(path)
    assert again.set_aside is not None
    assert again.set_aside.read_bytes() == bytes(raw)
    assert again.history() == []
    again.confirm(again.begin(entry(), {}).number)
    again.close()


def test_one_process_has_it(journal: Journal) -> None:
    """A second gateway that runs the same file is told so."""
    with pytest.raises(JournalError, match="another gateway that runs the same file has it"):
        Journal(journal.path)


def test_a_full_disk(journal: Journal) -> None:
    """Where nothing can be written any more, that is an error that says so, and what was there stays."""
    journal.confirm(journal.begin(entry(), {"n": 1}).number)
    with journal._connection() as db:
        (pages,) = db.execute("PRAGMA page_count").fetchone()
        db.execute(f"PRAGMA max_page_count = {pages}")
    with pytest.raises(JournalError, match="full"):
        journal.begin(entry("e2"), {"n": "".join(chr(33 + (i * 7919) % 90) for i in range(1 << 20))})
    last = journal.last_up()
    assert last is not None
    assert journal.config(last) == {"n": 1}


def test_a_place_that_cannot_be(tmp_path: Path) -> None:
    """A path where no file can be is an error that names it."""
    (tmp_path / "file").touch()
    with pytest.raises(JournalError, match="file"):
        Journal(tmp_path / "file" / "robot.journal")
    (tmp_path / "directory.journal").mkdir()
    with pytest.raises(JournalError, match="directory"):
        Journal(tmp_path / "directory.journal")


def test_old_entries_are_forgotten(tmp_path: Path) -> None:
    """Above the limit the oldest go, with their configurations; the last that came up stays."""
    journal = Journal(tmp_path / "robot.journal", most_entries=50)
    good = journal.begin(entry("good"), {"n": "good"})
    journal.confirm(good.number)
    for number in range(126):
        journal.begin(entry(f"e{number}"), {"n": number})
    journal.confirm(128 if journal.entry(128) else journal.begin(entry("last"), {}).number)
    assert len(journal.history(count=1000)) <= 51
    with journal._connection() as db:
        (contents,) = db.execute("SELECT count(*) FROM contents").fetchone()
    assert contents <= 51
    journal.close()


def test_a_newer_one(tmp_path: Path) -> None:
    """Strange rows are damage, not a crash."""
    path = tmp_path / "robot.journal"
    Journal(path).close()
    with sqlite3.connect(path) as db:
        db.execute("INSERT INTO contents VALUES ('e', x'00')")
        db.execute(
            "INSERT INTO entries (time_s, who, place, action, source, file_digest, etag, state, note, plan) "
            "VALUES (0, 'a', 'b', 'c', 'd', 'e', 'e', 'up', '', 'no json')"
        )
    db.close()
    journal = Journal(path)
    assert journal.set_aside is not None
    journal.close()


def _write_until_closed(journal: Journal, number: int, begun: threading.Barrier, told: list[str]) -> None:
    begun.wait()
    try:
        while True:
            journal.fail(number, "again")
    except JournalError as error:
        told.append(str(error))


def test_closed_while_threads_write(tmp_path: Path) -> None:
    """A journal that is closed while other threads write ends no process: they are told that it is closed."""
    for count in range(20):
        journal = Journal(tmp_path / f"{count}.journal")
        number = journal.begin(entry(), {"n": count}).number
        begun = threading.Barrier(5)
        told: list[str] = []
        threads = [threading.Thread(target=_write_until_closed, args=(journal, number, begun, told)) for _ in range(4)]
        for thread in threads:
            thread.start()
        begun.wait()
        journal.close()
        journal.close()
        for thread in threads:
            thread.join()
        assert ["closed" in text for text in told] == [True] * 4
