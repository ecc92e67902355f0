"""Bags of ROS 1 that are cut short."""

from __future__ import annotations

from pathlib import Path

import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from rosbags.rosbag1 import Writer

from ropeway.errors import BagUnreadable
from ropeway.recording.bag import Bag
from ropeway.types import TypeRegistry

COUNT = 60


@pytest.fixture(scope="module")
def whole(tmp_path_factory: pytest.TempPathFactory) -> bytes:
    """A bag of texts in several chunks."""
    path = tmp_path_factory.mktemp("ros1") / "a.bag"
    registry = TypeRegistry()
    codec = registry.codec("std_msgs/msg/String")
    writer = Writer(path)
    writer.chunk_threshold = 200
    with writer:
        connection = writer.add_connection(
            "/text", codec.type, msgdef="string data\n", md5sum=registry.md5(codec.type), latching=1
        )
        for number in range(COUNT):
            writer.write(connection, 10**9 + number, codec.ros1(codec.encode({"data": str(number)})))
    return path.read_bytes()


@settings(max_examples=40, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(share=st.floats(0.0, 0.999))
def test_cut_short(tmp_path: Path, whole: bytes, share: float) -> None:
    """Of a bag without an index all that is whole is played, and it is told; if nothing is, the bag is refused."""
    path = tmp_path / "cut.bag"
    path.write_bytes(whole[: max(13, int(len(whole) * share))])
    registry = TypeRegistry()
    try:
        with Bag(path, registry) as bag:
            texts = [registry.codec(r.topic.type).decode(r.payload)["data"] for r in bag.records()]
            notes = bag.notes
    except BagUnreadable as error:
        assert "cut short" in str(error)
    else:
        assert texts == [str(number) for number in range(len(texts))]
        assert "no index" in notes[0]


def test_all_of_it_is_found_without_the_index(tmp_path: Path, whole: bytes) -> None:
    """A bag whose recorder was killed right before the index is played whole, with its latched topics."""
    path = tmp_path / "cut.bag"
    path.write_bytes(whole[:-10])
    with Bag(path, TypeRegistry()) as bag:
        assert len(list(bag.records())) == COUNT
        assert bag.topics[0].qos.latched
