"""The header of requests and replies."""

from __future__ import annotations

import struct

import pytest
from hypothesis import example, given
from hypothesis import strategies as st

from ropeway.networks.dds.rpc import MAX_SEQ, RequestHeader, join, split

headers = st.builds(RequestHeader, st.integers(0, 2**64 - 1), st.integers(1, MAX_SEQ))
payloads = st.binary(max_size=64).map(lambda body: b"\0\1\0\0" + body)


@given(headers, payloads)
def test_back_again(header: RequestHeader, payload: bytes) -> None:
    """What is joined is split into the same header and payload."""
    message = join(header, payload)
    assert len(message) == len(payload) + 16
    assert split(message) == (header, payload)


def test_layout() -> None:
    """The numbers stand behind the CDR header, the client before the request."""
    assert join(RequestHeader(1, 2), b"\0\1\0\0abc") == b"\0\1\0\0" + struct.pack("<Qq", 1, 2) + b"abc"


@given(headers, payloads)
def test_other_byte_order(header: RequestHeader, payload: bytes) -> None:
    """A sender of the other byte order is known by its header, whichever order the library claims."""
    for claimed in (b"\0\0\0\0", b"\0\1\0\0"):
        message = split(claimed + struct.pack(">Qq", *header) + payload[4:])
        assert message is not None
        if message.payload[1] == 0:
            assert message == (header, b"\0\0\0\0" + payload[4:])
        else:  # a number that makes sense either way
            assert 0 < message.header.seq <= MAX_SEQ


@given(st.binary(max_size=64))
@example(b"")
@example(b"\0\1\0\0" + bytes(15))
@example(b"\0\1\0\0" + b"\xff" * 16)
@example(b"\0\0\0\0" + bytes(16))
@example(b"\0\3\0\0" + bytes(40))
def test_hostile(message: bytes) -> None:
    """Any bytes are either a message or none."""
    found = split(message)
    if len(message) < 20 or message[:2] not in (b"\0\0", b"\0\1"):
        assert found is None
    else:
        assert found is not None
        assert found.payload[2:] == message[2:4] + message[20:]
        join(found.header, b"\0\1\0\0")


def test_impossible_numbers() -> None:
    """Numbers that have no room are refused."""
    with pytest.raises(struct.error):
        join(RequestHeader(-1, 1), b"\0\1\0\0")
