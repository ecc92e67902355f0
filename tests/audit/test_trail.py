"""The audit log takes notes at once, bounded, and says what it lost."""

from __future__ import annotations

import asyncio
import threading
from collections.abc import Callable, Iterable, Sequence
from pathlib import Path
from typing import Any

from ropeway.audit.files import AuditFiles, AuditLine
from ropeway.audit.merging import Merger
from ropeway.audit.note import AuditNote
from ropeway.audit.trail import AuditQuery, AuditTrail
from tests.support.until import until


class Sink:
    """A sink in memory, which may fail or wait."""

    def __init__(self) -> None:
        self.written: list[dict[str, Any]] = []
        self.error: OSError | None = None
        self.free = threading.Event()
        self.free.set()
        self.calls = 0

    def open(self) -> int:
        return 0

    def append(self, entries: Sequence[dict[str, Any]]) -> None:
        self.calls += 1
        self.free.wait(10)
        if self.error is not None:
            raise self.error
        self.written += entries

    def backwards(self, wanted: Callable[[bytes], bool], before: int | None) -> Iterable[AuditLine]:
        lines = [AuditLine(entry["number"], 100, entry) for entry in reversed(self.written)]
        return [line for line in lines if before is None or line.number < before]

    def close(self) -> None:
        pass


class Clock:
    """A clock that a test moves."""

    now = 0.0

    def __call__(self) -> float:
        return self.now


def _files(path: Path) -> AuditFiles:
    return AuditFiles(path, file_bytes=1 << 20, files=2, file_days=1.0, keep_days=1.0)


def _note(name: str = "/a", payload: bytes | None = None) -> AuditNote:
    return AuditNote("command", "publish", name, "role driver", "10.0.0.7:1", payload=payload)


async def test_notes_are_written_and_read(tmp_path: Path) -> None:
    """A note is in the file and can be asked for by kind, text, time and number, also by the next process."""
    path = tmp_path / "audit"
    trail = AuditTrail(_files(path))
    trail.note(_note("/cmd_vel", b"secret"))
    trail.note(AuditNote("change", "apply", who="anna", where="unix:1"))
    await until(lambda: len(trail.read(AuditQuery())[0]) == 2)
    trail.close()
    assert b"secret" not in path.read_bytes()
    again = AuditTrail(_files(path))
    entries, more = again.read(AuditQuery())
    assert ([entry["kind"] for entry in entries], more) == (["command", "change"], None)
    first, second = (entry["number"] for entry in entries)
    for query, numbers in (
        (AuditQuery(kinds=frozenset({"change"})), [second]),
        (AuditQuery(name="cmd"), [first]),
        (AuditQuery(who="ann"), [second]),
        (AuditQuery(after=first), [second]),
        (AuditQuery(before=second), [first]),
        (AuditQuery(until_s=1.0), []),
        (AuditQuery(count=1), [second]),
    ):
        assert [entry["number"] for entry in again.read(query)[0]] == numbers, query
    again.note(_note())
    await until(lambda: len(again.read(AuditQuery())[0]) == 3)
    numbers = [entry["number"] for entry in again.read(AuditQuery())[0]]
    assert numbers == sorted(set(numbers))
    again.close()


async def test_a_request_looks_through_a_part(tmp_path: Path) -> None:
    """A request that finds little in a long log says where to go on, and going on finds everything."""
    sink = Sink()
    sink.written = [{"number": number, "time": 1.0, "kind": "change", "name": str(number)} for number in range(1, 101)]
    trail = AuditTrail(sink)
    found, before = trail.read(AuditQuery(name="7"), scan_bytes=1000)
    assert before is not None
    while before is not None:
        more, before = trail.read(AuditQuery(name="7", before=before), scan_bytes=1000)
        found = more + found
    assert [entry["name"] for entry in found] == [str(n) for n in range(1, 101) if "7" in str(n)]


async def test_what_does_not_fit_is_counted() -> None:
    """A queue that is full drops notes, and the log says how many of which kind."""
    sink = Sink()
    sink.free.clear()
    trail = AuditTrail(sink, queue_bytes=5000, merger=Merger(per_sender=10_000))
    trail.note(_note("/first"))
    await until(lambda: sink.calls == 1)
    for number in range(100):
        trail.note(_note(f"/a{number}", bytes(1000)))
    sink.free.set()
    await until(lambda: any(entry["kind"] == "audit" for entry in sink.written))
    [lost] = [entry for entry in sink.written if entry["kind"] == "audit"]
    assert lost["details"]["kinds"] == {"command": lost["times"]}
    assert len(sink.written) - 2 + lost["times"] == 100
    assert trail.status()["lost"] == lost["times"]
    trail.close()


async def test_a_disk_that_fails_is_tried_again() -> None:
    """What cannot be written stays readable, and is written once that works; the log says what was forgotten."""
    sink, clock = Sink(), Clock()
    sink.error = OSError(28, "No space left on device")
    trail = AuditTrail(sink, kept=5, clock=clock, merger=Merger(per_sender=1000))
    for number in range(8):
        trail.note(_note(f"/{number}"))
    await until(lambda: trail.last_number and len(trail.read(AuditQuery())[0]) == 5)
    assert trail.status() == {"lost": 0, "unwritten": 5, "error": "No space left on device"}
    sink.error = None
    clock.now = 100.0
    trail.note(_note("/last"))
    await until(lambda: len(sink.written) > 1)
    gap, *rest = sink.written
    assert (gap["operation"], gap["times"]) == ("forgotten", 4)
    assert [entry["name"] for entry in rest] == ["/4", "/5", "/6", "/7", "/last"]
    assert trail.status()["error"] == ""
    trail.close()


async def test_a_directory_that_is_none_never_stops_anything(tmp_path: Path) -> None:
    """Where no file can be made, notes are kept in memory."""
    (tmp_path / "file").write_text("")
    trail = AuditTrail(_files(tmp_path / "file" / "audit"))
    trail.note(_note())
    await until(lambda: trail.status()["unwritten"] == 1)
    assert [entry["name"] for entry in trail.read(AuditQuery())[0]] == ["/a"]
    trail.close()


async def test_readers_follow() -> None:
    """A reader gets entries as they come, and an end when the log ends."""
    trail = AuditTrail(Sink())
    names: list[str] = []

    async def follow() -> None:
        async for entry in trail.follow(AuditQuery(), idle_s=60.0):
            if entry is not None:
                names.append(entry["name"])

    following = asyncio.create_task(follow())
    trail.note(_note("/a"))
    await until(lambda: names == ["/a"])
    trail.note(_note("/b"))
    await until(lambda: names == ["/a", "/b"])
    trail.close()
    await following


async def test_entries_of_workers_are_written() -> None:
    """What a worker has made of its notes is numbered and written with the rest."""
    sink = Sink()
    trail = AuditTrail(sink)
    trail.take_entries([{"time": 1.0, "kind": "denied", "name": "/a"}])
    await until(lambda: len(sink.written) == 1)
    assert sink.written[0]["number"] == trail.last_number
    trail.close()
