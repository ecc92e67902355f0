"""MCAP files of every make, whole and damaged."""

from __future__ import annotations

import logging
from pathlib import Path
from typing import Any

import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from mcap.writer import IndexType, Writer

from ropeway.errors import BagUnreadable
from ropeway.recording.bag import Bag
from ropeway.types import TypeRegistry

COUNT = 60


def write(path: Path, **options: Any) -> Path:
    """A recording of texts, with small chunks."""
    with path.open("wb") as file:
        writer = Writer(file, chunk_size=200, **options)
        writer.start("ros2")
        schema = writer.register_schema("std_msgs/msg/String", "ros2msg", b"string data\n")
        channel = writer.register_channel("/text", "cdr", schema)
        codec = TypeRegistry().codec("std_msgs/msg/String")
        for number in range(COUNT):
            writer.add_message(channel, 10**9 + number, codec.encode({"data": str(number)}), 0)
        writer.finish()
    return path


def read(path: Path) -> tuple[list[str], list[str]]:
    """The texts of a recording, and what is told of it."""
    registry = TypeRegistry()
    with Bag(path, registry) as bag:
        texts = [registry.codec(r.topic.type).decode(r.payload)["data"] for r in bag.records()]
        assert len(texts) == sum(topic.count for topic in bag.topics)
        return texts, list(bag.notes)


@settings(max_examples=40, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(
    statistics=st.booleans(),
    channels=st.booleans(),
    schemas=st.booleans(),
    offsets=st.booleans(),
    index=st.sampled_from([IndexType.ALL, IndexType.NONE, IndexType.CHUNK, IndexType.MESSAGE]),
    chunking=st.booleans(),
)
def test_optional_records(
    tmp_path: Path, statistics: bool, channels: bool, schemas: bool, offsets: bool, index: IndexType, chunking: bool
) -> None:
    """A recording plays whole whichever optional records it has, and nothing is told of it."""
    path = write(
        tmp_path / "a.mcap",
        use_statistics=statistics,
        repeat_channels=channels,
        repeat_schemas=schemas,
        use_summary_offsets=offsets,
        index_types=index,
        use_chunking=chunking,
    )
    assert read(path) == ([str(number) for number in range(COUNT)], [])


@settings(max_examples=40, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(share=st.floats(0.0, 0.99), chunking=st.booleans())
def test_cut_short(tmp_path: Path, share: float, chunking: bool) -> None:
    """Of a recording that is cut short all that is whole is played, and it is told; if nothing is, it is refused."""
    whole = write(tmp_path / "whole.mcap", use_chunking=chunking).read_bytes()
    path = tmp_path / "cut.mcap"
    path.write_bytes(whole[: max(8, int(len(whole) * share))])
    try:
        texts, notes = read(path)
    except BagUnreadable as error:
        assert "cut short" in str(error)
    else:
        assert texts == [str(number) for number in range(len(texts))]
        assert "mcap recover" in notes[0]


def test_a_damaged_chunk_costs_no_other(tmp_path: Path) -> None:
    """A chunk that cannot be unpacked is left out and told; the others are played."""
    path = write(tmp_path / "a.mcap", use_statistics=False)
    content = bytearray(path.read_bytes())
    where = content.index(b"\x28\xb5\x2f\xfd", len(content) // 4)  # where a zstd frame begins
    content[where : where + 4] = bytes(4)
    path.write_bytes(content)
    texts, notes = read(path)
    assert 0 < len(texts) < COUNT
    assert notes == ["1 of its chunks cannot be read, and what they hold is left out"]


def test_a_summary_that_lies_is_told(tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    """A recording that plays fewer messages than its own statistics tell says so."""
    path = tmp_path / "a.mcap"
    with path.open("wb") as file:
        writer = Writer(file, chunk_size=200)
        writer.start("ros2")
        schema = writer.register_schema("std_msgs/msg/String", "ros2msg", b"string data\n")
        channel = writer.register_channel("/text", "cdr", schema)
        writer.add_message(channel, 1, b"\0\1\0\0\1\0\0\0\0", 0)
        statistics: Any = writer._Writer__statistics  # type: ignore[attr-defined]
        statistics.message_count += 1
        statistics.channel_message_counts[channel] += 1
        writer.finish()
    with caplog.at_level(logging.WARNING), Bag(path, TypeRegistry()) as bag:
        assert len(list(bag.records())) == 1
    assert "it lists 2 messages, but only 1 are there" in caplog.text
