"""ropeway.recording.writer: a recording while messages come."""

from __future__ import annotations

import asyncio
import threading
from collections.abc import Iterable
from pathlib import Path

import pytest

from ropeway.errors import RecordingFailed
from ropeway.recording.bag import Bag
from ropeway.recording.channel import Recorded
from ropeway.recording.files import McapFiles
from ropeway.recording.writer import FAILED, SLOW, RecordingWriter
from ropeway.types import TypeRegistry
from tests.recording.test_files import channel, messages
from tests.support.messages import text
from tests.support.until import until


async def test_all_are_written(tmp_path: Path) -> None:
    """What was given is in the file, in order, when it is closed."""
    writer = RecordingWriter(McapFiles(tmp_path / "a.mcap"))
    for message in messages(channel(), 5_000):
        writer.put(message)
    await writer.close()
    assert not writer.dropped
    with Bag(tmp_path / "a.mcap", TypeRegistry()) as bag:
        assert [one.payload for one in bag.records()] == [text(str(n)) for n in range(5_000)]


async def test_it_is_written_while_it_goes_on(tmp_path: Path) -> None:
    """What comes is given to the disk soon, not at the end."""
    writer = RecordingWriter(McapFiles(tmp_path / "a.mcap"))
    writer.put(messages(channel(), 1)[0])
    await until(lambda: writer.files.messages == 1)
    await writer.close()


class Stuck(McapFiles):
    """A disk that does not answer before it is told to."""

    def __init__(self, path: Path) -> None:
        super().__init__(path)
        self.go_on = threading.Event()

    def write(self, messages: Iterable[Recorded]) -> None:
        self.go_on.wait()
        super().write(messages)


async def test_a_slow_disk(tmp_path: Path) -> None:
    """What is too much for the disk is dropped and counted; memory is bounded, and what was taken is written."""
    files = Stuck(tmp_path / "a.mcap")
    writer = RecordingWriter(files, most_waiting_bytes=100_000)
    for message in messages(channel(), 1_000):
        writer.put(message)
    assert 0 < writer.dropped[SLOW] < 1_000
    files.go_on.set()
    await writer.close()
    assert files.messages == 1_000 - writer.dropped[SLOW]


async def test_a_disk_that_fails(tmp_path: Path) -> None:
    """A recording that fails says so, takes nothing more, and counts what is lost."""
    (tmp_path / "a.mcap").touch()
    failed = asyncio.Event()
    writer = RecordingWriter(McapFiles(tmp_path / "a.mcap"), on_failure=failed.set)
    first, second = messages(channel(), 2)
    writer.put(first)
    await failed.wait()
    writer.put(second)
    assert writer.dropped == {FAILED: 2}
    with pytest.raises(RecordingFailed, match="another name"):
        await writer.close()
