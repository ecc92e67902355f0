"""Sample identities in RTPS messages, as Cyclone DDS leaves them in memory."""

from __future__ import annotations

import struct
import sys

import pytest
from hypothesis import given
from hypothesis import strategies as st

from ropeway.networks.dds.fastdds.identity import (
    PID_RELATED,
    PID_RELATED_OLD,
    UNKNOWN_SEQ,
    SampleIdentity,
    is_reader,
    pack_parameter,
    parse,
)

NATIVE = "<" if sys.byteorder == "little" else ">"
PREFIX = bytes.fromhex("010f0102030405060708090a")
WRITER = PREFIX + bytes.fromhex("00001403")
HEADER = b"RTPS\2\3\1\x0f" + struct.pack("=3I", *struct.unpack(">3I", PREFIX))
guids = st.binary(min_size=16, max_size=16)
numbers = st.integers(-(2**31) << 32, 2**63 - 1)


def parameter(order: str, pid: int, identity: SampleIdentity) -> bytes:
    return struct.pack(order + "HH16siI", pid, 24, identity.guid, identity.seq >> 32, identity.seq & 0xFFFFFFFF)


def data(parameters: bytes | None, *, order: str = NATIVE, seq: int = 7, kind: int = 0x15) -> bytes:
    """A DATA or DATA_FRAG up to its payload; only its parameters are in the sender's ``order``."""
    flags = 4 | (order == "<") | (0 if parameters is None else 2)
    entity = struct.unpack(">I", WRITER[12:])[0]
    head = struct.pack("=BBHHHIIiI", kind, flags, 0, 0, 16, 0, entity, seq >> 32, seq & 0xFFFFFFFF)
    return head + (parameters or b"")


END = struct.pack("<HH", 1, 0)
ASKER = SampleIdentity(bytes(range(16)), UNKNOWN_SEQ)


def test_plain() -> None:
    """A sample without parameters has a writer, a number and a vendor."""
    origin = parse(HEADER, data(None, seq=5 << 32 | 9))
    assert origin is not None
    assert (origin.vendor, origin.identity) == (b"\1\x0f", SampleIdentity(WRITER, 5 << 32 | 9))
    assert (origin.related, origin.parameter) == (None, 0)


@pytest.mark.parametrize("pid", [PID_RELATED, PID_RELATED_OLD])
@given(guid=guids, seq=numbers, order=st.sampled_from("<>"))
def test_related(pid: int, guid: bytes, seq: int, order: str) -> None:
    """A related identity is found among other parameters, in the byte order of its sender."""
    identity = SampleIdentity(guid, seq)
    other = struct.pack(order + "HHI", 0x71, 4, 0)
    end = struct.pack(order + "HH", 1, 0)
    origin = parse(HEADER, data(other + parameter(order, pid, identity) + end, order=order))
    assert origin is not None
    assert (origin.related, origin.parameter) == (identity, pid)


@given(first=st.booleans())
def test_both(*, first: bool) -> None:
    """Where both parameters are there, the one of the standard counts."""
    old = parameter("<", PID_RELATED_OLD, SampleIdentity(bytes(16), 1))
    new = parameter("<", PID_RELATED, ASKER)
    origin = parse(HEADER, data(old + new + END if first else new + old + END, order="<"))
    assert origin is not None
    assert (origin.related, origin.parameter) == (ASKER, PID_RELATED)


@given(guid=guids, seq=numbers, pid=st.sampled_from([PID_RELATED, PID_RELATED_OLD]))
def test_round_trip(guid: bytes, seq: int, pid: int) -> None:
    """What is packed is what is parsed."""
    packed = pack_parameter(pid, SampleIdentity(guid, seq))
    assert len(packed) == 28
    origin = parse(HEADER, data(packed))
    assert origin is not None
    assert (origin.related, origin.parameter) == ((guid, seq), pid)


@given(header=st.binary(max_size=24) | st.just(HEADER), submessage=st.binary(max_size=120))
def test_hostile(header: bytes, submessage: bytes) -> None:
    """Any bytes are an origin or none."""
    origin = parse(header, submessage)
    assert origin is None or len(origin.identity.guid) == 16


@given(rest=st.binary(max_size=60), at=st.integers(0, 0xFFFF), flags=st.integers(0, 255))
def test_hostile_parameters(rest: bytes, at: int, flags: int) -> None:
    """Parameters that end too early, or are not where they should be, are no related identity or a whole one."""
    head = struct.pack("=BBHHHIIiI", 0x15, flags, 0, 0, at, 0, 0, 0, 1)
    origin = parse(HEADER, head + rest)
    assert origin is not None
    assert origin.related is None or len(origin.related.guid) == 16


def test_too_many_parameters() -> None:
    """A list without an end is left after some parameters."""
    origin = parse(HEADER, data(struct.pack("<HH", 0x70, 0) * 100 + parameter("<", PID_RELATED, ASKER), order="<"))
    assert origin is not None
    assert origin.related is None


def test_is_reader() -> None:
    """The last byte of a GUID tells a reader from a writer."""
    assert is_reader(PREFIX + b"\0\0\1\4")
    assert is_reader(PREFIX + b"\0\0\1\7")
    assert not is_reader(WRITER)
