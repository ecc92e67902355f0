"""ropeway.recording.files: MCAP files that stand alone."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
from pathlib import Path

import pytest

from ropeway.errors import RecordingFailed
from ropeway.qos import LATCHED, QoS
from ropeway.recording.bag import Bag
from ropeway.recording.channel import Recorded, RecordingChannel, cdr_channel, json_channel
from ropeway.recording.files import McapFiles
from ropeway.recording.mcap_writer import COMPRESSIONS
from ropeway.types import TypeRegistry
from tests.support.messages import STRING, text

REGISTRY = TypeRegistry()


def channel(topic: str = "/a") -> RecordingChannel:
    return cdr_channel(REGISTRY, topic, STRING, [QoS(reliability="best_effort", depth=3)])


def messages(channel: RecordingChannel, count: int, *, start: int = 0) -> list[Recorded]:
    return [Recorded(channel, 10**18 + n * 10**8, text(str(n))) for n in range(start, start + count)]


@pytest.mark.parametrize("compression", COMPRESSIONS)
def test_whole(tmp_path: Path, compression: str) -> None:
    """What was written is read again: messages, types, definitions and QoS."""
    files = McapFiles(tmp_path / "a.mcap", compression=compression)
    latched = cdr_channel(REGISTRY, "/b", STRING, [LATCHED])
    files.write(messages(channel(), 100))
    files.write(messages(latched, 2))
    files.close()
    assert (files.paths, files.messages) == ([tmp_path / "a.mcap"], 102)
    with Bag(tmp_path / "a.mcap", TypeRegistry()) as bag:
        assert [(one.name, one.type, one.count) for one in bag.topics] == [("/a", STRING, 100), ("/b", STRING, 2)]
        assert [one.qos.reliability for one in bag.topics] == ["best_effort", "reliable"]
        assert bag.topics[1].qos.transient_local
        assert [one.payload for one in bag.records(["/a"])] == [text(str(n)) for n in range(100)]


def test_split(tmp_path: Path) -> None:
    """Where it is split, by bytes or by time, each file stands alone and nothing is lost between."""
    by_bytes = McapFiles(tmp_path / "b.mcap", split_bytes=200)
    by_bytes.write(messages(channel(), 100))
    by_bytes.close()
    by_time = McapFiles(tmp_path / "t", split_s=2.0)
    by_time.write(messages(channel(), 100))
    by_time.close()
    assert len(by_time.paths) == 5
    for files in (by_bytes, by_time):
        found: list[bytes] = []
        for path in files.paths:
            with Bag(path, TypeRegistry()) as bag:
                found += [one.payload for one in bag.records()]
        assert found == [text(str(n)) for n in range(100)]
    assert [path.name for path in by_time.paths] == [f"t_{n}.mcap" for n in range(5)]


def test_nothing_is_written_over(tmp_path: Path) -> None:
    """A file that is there stays as it is, and an empty recording has none."""
    (tmp_path / "a.mcap").write_bytes(b"mine")
    files = McapFiles(tmp_path / "a.mcap")
    with pytest.raises(RecordingFailed, match="another name"):
        files.write(messages(channel(), 1))
    assert (tmp_path / "a.mcap").read_bytes() == b"mine"
    empty = McapFiles(tmp_path / "b.mcap")
    empty.close()
    assert not (tmp_path / "b.mcap").exists()


def test_what_is_no_message_of_ros(tmp_path: Path) -> None:
    """JSON, and a type that nobody knows, are recorded as what they are."""
    files = McapFiles(tmp_path / "a.mcap")
    unknown = cdr_channel(REGISTRY, "/u", "own_msgs/msg/Own", [])
    files.write([Recorded(json_channel("/j", "Title"), 5, b'{"a":1}'), Recorded(unknown, 6, b"\0\1\0\0")])
    files.close()
    with Bag(tmp_path / "a.mcap", TypeRegistry()) as bag:
        assert [(one.name, one.count, bool(one.problem)) for one in bag.topics] == [("/j", 1, True), ("/u", 1, False)]


@pytest.mark.skipif(os.geteuid() != 0, reason="a full disk is made by root")
def test_a_full_disk(tmp_path: Path) -> None:
    """A full disk is an error that says so; what was written before can be read."""
    subprocess.run(["mount", "-t", "tmpfs", "-o", "size=4m", "ropeway-test", tmp_path], check=True)
    try:
        files = McapFiles(tmp_path / "a.mcap")
        with pytest.raises(RecordingFailed, match="No space left"):
            for _ in range(1000):
                files.write(Recorded(one.channel, one.time_ns, text("x" * 9_000)) for one in messages(channel(), 1000))
                files.flush()
        files.close()
        with Bag(tmp_path / "a.mcap", TypeRegistry()) as bag:
            assert bag.notes == []
            assert sum(one.count for one in bag.topics) == len(list(bag.records())) == files.messages > 0
    finally:
        subprocess.run(["umount", tmp_path], check=True)


def test_a_process_that_is_killed(tmp_path: Path) -> None:
    """Of a process that is killed all is read up to the last chunk, and it is said that the file is cut short."""
    path = tmp_path / "a.mcap"
    code = f"""
import os, signal, sys
from pathlib import Path
from ropeway.recording.files import McapFiles
from tests.recording.test_files import channel, messages
files = McapFiles(Path({str(path)!r}))
files.write(messages(channel(), 70))
files.flush(everything=True)
files.write(messages(channel(), 5, start=70))
os.kill(os.getpid(), signal.SIGKILL)
"""
    ended = subprocess.run([sys.executable, "-c", code], check=False, cwd=Path(__file__).parents[2])
    assert ended.returncode == -signal.SIGKILL
    with Bag(path, TypeRegistry()) as bag:
        assert "cut short" in bag.notes[0]
        assert [one.count for one in bag.topics] == [70]
        assert [one.payload for one in bag.records()] == [text(str(n)) for n in range(70)]
