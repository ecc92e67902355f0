"""ropeway.recording.mcap_writer: chunks, indexes and checksums as other readers expect them."""

from __future__ import annotations

import os
from collections.abc import Iterator
from io import FileIO
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st
from mcap.reader import NonSeekingReader, SeekingReader
from mcap.records import Message

from ropeway.recording.mcap_writer import CHUNK_BYTES, COMPRESSIONS, McapWriter

SCHEMA = ("std_msgs/msg/String", "ros2msg", "string data\n")


def new(path: Path, compression: str = "none") -> McapWriter:
    path.unlink(missing_ok=True)
    return McapWriter(FileIO(path, "xb"), compression=compression, library="test")


def read(path: Path) -> list[Message]:
    """Return the messages as the reference reader finds them by the index, all checksums checked."""
    with path.open("rb") as file:
        return [found for _, _, found in SeekingReader(file, validate_crcs=True).iter_messages()]


PAYLOADS = st.lists(st.tuples(st.integers(0, 2**63), st.sampled_from((0, 1, 100, 8 << 10, 300_000))), max_size=30)


@pytest.mark.parametrize("compression", COMPRESSIONS)
@given(given_=PAYLOADS)
def test_every_message_is_found(
    tmp_path_factory: pytest.TempPathFactory, compression: str, given_: list[tuple[int, int]]
) -> None:
    """Messages of any size and time are found by the index and from front to back, with their bytes and counts."""
    path = tmp_path_factory.getbasetemp() / f"{compression}.mcap"
    writer = new(path, compression)
    numbers = [writer.add_channel(topic, "cdr", SCHEMA, {"key": topic}) for topic in ("/a", "/b")]
    written = [(numbers[n % 2], time_ns, os.urandom(size)) for n, (time_ns, size) in enumerate(given_)]
    for sequence, (channel, time_ns, payload) in enumerate(written):
        writer.add_message(channel, time_ns, sequence, payload)
    writer.finish()
    found = sorted(read(path), key=lambda one: one.sequence)
    assert [(one.channel_id, one.log_time, one.data) for one in found] == written
    with path.open("rb") as file:
        in_order = [one.data for _, _, one in NonSeekingReader(file, validate_crcs=True).iter_messages()]
        assert sorted(in_order) == sorted(payload for _, _, payload in written)
    with path.open("rb") as file:
        summary = SeekingReader(file, validate_crcs=True).get_summary()
    assert summary is not None
    assert summary.statistics.message_count == len(written)
    assert [one.topic for one in summary.channels.values()] == ["/a", "/b"]
    assert len(summary.schemas) == 1
    if written:
        times = [time_ns for _, time_ns, _ in written]
        assert (summary.statistics.message_start_time, summary.statistics.message_end_time) == (min(times), max(times))


def test_a_chunk_ends_when_it_is_large(tmp_path: Path) -> None:
    """A chunk is written once it has so many bytes, and what is less waits until it is asked for."""
    writer = new(tmp_path / "a.mcap")
    channel = writer.add_channel("/a", "cdr", SCHEMA, {})
    writer.add_message(channel, 1, 0, bytes(CHUNK_BYTES))
    assert (tmp_path / "a.mcap").stat().st_size > CHUNK_BYTES
    assert not writer.pending
    writer.add_message(channel, 2, 1, b"few")
    assert writer.pending
    before = (tmp_path / "a.mcap").stat().st_size
    writer.end_chunk()
    assert (tmp_path / "a.mcap").stat().st_size > before
    writer.finish()


@pytest.fixture
def no_writev(monkeypatch: pytest.MonkeyPatch) -> Iterator[None]:
    """A system without a call that writes several parts."""
    monkeypatch.delattr(os, "writev")
    yield


def test_without_a_call_for_several_parts(no_writev: None, tmp_path: Path) -> None:
    """The file is the same where the system writes one part at a time."""
    writer = new(tmp_path / "a.mcap")
    channel = writer.add_channel("/a", "cdr", SCHEMA, {})
    for number in range(10):
        writer.add_message(channel, number, number, bytes([number]) * 100_000)
    writer.finish()
    assert [one.data[:1] for one in read(tmp_path / "a.mcap")] == [bytes([number]) for number in range(10)]
