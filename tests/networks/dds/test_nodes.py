"""The messages of ros_discovery_info."""

from __future__ import annotations

import struct

import pytest
from hypothesis import given
from hypothesis import strategies as st

from ropeway.networks.dds.nodes import NodeEntities, ParticipantEntities, encode, full_name, parse

guids = st.binary(min_size=16, max_size=16)
names = st.from_regex(r"(/[a-z_][a-z0-9_]{0,8}){1,3}", fullmatch=True)
nodes = st.builds(NodeEntities, names, st.lists(guids, max_size=4).map(tuple), st.lists(guids, max_size=4).map(tuple))
messages = st.builds(ParticipantEntities, guids, st.lists(nodes, max_size=4).map(tuple), st.sampled_from([16, 24]))


@given(messages)
def test_round_trip(entities: ParticipantEntities) -> None:
    """What is written is read, and the size of its gids is recognised."""
    assert parse(encode(entities)) == entities


def test_recorded() -> None:
    """A message laid out by hand, as a node of ROS 2 Jazzy writes it, is read."""
    raw = b"\0\1\0\0" + bytes(range(16)) + struct.pack("<I", 1)
    raw += struct.pack("<I", 2) + b"/\0" + b"\0\0" + struct.pack("<I", 7) + b"talker\0" + b"\0"
    raw += struct.pack("<I", 0) + struct.pack("<I", 1) + b"W" * 16
    assert parse(raw) == ParticipantEntities(bytes(range(16)), (NodeEntities("/talker", (), (b"W" * 16,)),))


def test_big_endian() -> None:
    """A message of a big-endian machine is read, too."""
    raw = b"\0\0\0\0" + bytes(range(16)) + struct.pack(">I", 0)
    assert parse(raw) == ParticipantEntities(bytes(range(16)), ())


@given(st.binary(max_size=200))
def test_hostile(raw: bytes) -> None:
    """Any bytes are either a message or nothing; none raises."""
    for payload in (raw, b"\0\1\0\0" + raw):
        found = parse(payload)
        assert found is None or len(found.guid) == 16


@pytest.mark.parametrize("count", [2, 1000, 2**31, 2**32 - 1])
def test_hostile_counts(count: int) -> None:
    """A count beyond the message is refused before anything is made of it."""
    assert parse(b"\0\1\0\0" + bytes(16) + struct.pack("<I", count) + bytes(24)) is None


@given(messages, st.integers(0, 30))
def test_truncated(entities: ParticipantEntities, cut: int) -> None:
    """A message that was cut is refused or read as what is left, never with an error."""
    raw = encode(entities)
    parse(raw[: max(len(raw) - cut, 0)])


def test_full_name() -> None:
    """Namespace and name join with one slash."""
    assert full_name("/", "a") == "/a"
    assert full_name("/ns", "a") == "/ns/a"
    assert full_name("", "a") == "/a"
