"""ropeway.networks.zenoh.attachment: what rmw_zenoh attaches to messages is read and written."""

from __future__ import annotations

import struct

import pytest
from hypothesis import given
from hypothesis import strategies as st

from ropeway.networks.zenoh.attachment import Attachment, pack, parse

from .genuine import ANSWERS, MESSAGES, REQUESTS

_GID = bytes(range(16))


@given(st.integers(0, 2**63 - 1), st.integers(0, 2**63 - 1), st.binary(min_size=16, max_size=16))
def test_round_trip(number: int, stamp_ns: int, gid: bytes) -> None:
    """What is packed is parsed again."""
    assert parse(pack(number, stamp_ns, gid)) == Attachment(number, stamp_ns, gid)


def test_layout() -> None:
    """An attachment is two integers of 64 bits, a count and 16 bytes."""
    assert pack(1, 2, _GID) == struct.pack("<qq", 1, 2) + b"\x10" + _GID


def test_with_names() -> None:
    """The attachment of the first releases of rmw_zenoh, with the names of its parts, is read as well."""
    data = b"\x0fsequence_number" + struct.pack("<q", 7) + b"\x10source_timestamp" + struct.pack("<q", 8)
    assert parse(data + b"\x0asource_gid\x10" + _GID) == Attachment(7, 8, _GID)
    assert parse(data + b"\x0asource_gi_\x10" + _GID) is None


@given(st.binary(max_size=80))
def test_other_bytes(data: bytes) -> None:
    """Other bytes are no attachment, or one that is packed to the same bytes."""
    found = parse(data)
    assert found is None or len(data) != 33 or pack(*found) == data


def test_negative() -> None:
    """A negative number or time, and a gid of another size, is refused."""
    for number, stamp_ns, size in ((-1, 0, 16), (0, -1, 16), (0, 0, 15)):
        assert parse(struct.pack("<qqB16s", number, stamp_ns, size, _GID)) is None


@pytest.mark.parametrize("message", [*MESSAGES, *REQUESTS], ids=lambda message: message["key"].partition("/RIHS")[0])
def test_genuine(message: dict[str, str]) -> None:
    """What a genuine node attaches is read, and written again as it came."""
    data = bytes.fromhex(message["attachment"])
    found = parse(data)
    assert found is not None
    assert pack(*found) == data
    assert (found.number >= 1, found.stamp_ns > 10**18) == (True, True)


def test_genuine_answer() -> None:
    """The answer of a genuine node has the number and the gid of the request that it was asked with."""
    found = parse(bytes.fromhex(ANSWERS[0]["attachment"]))
    assert found is not None
    assert (found.number, found.gid) == (5, _GID)
