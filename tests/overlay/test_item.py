"""Messages inside packets."""

from __future__ import annotations

import pytest
from hypothesis import given
from hypothesis import strategies as st

from ropeway.errors import SealError
from ropeway.overlay.item import RELAYED, ZSTD, Item, pack, unpack
from ropeway.overlay.refusal import Refusal


@given(st.integers(0, 2**64 - 1), st.integers(-(2**63), 2**63 - 1), st.binary(max_size=50))
def test_round_trip(number: int, stamp_ns: int, payload: bytes) -> None:
    """What is packed is unpacked, every field as it was."""
    item = Item(number, stamp_ns, 2**64 - 1, bytes(range(16)), RELAYED, ZSTD, payload)
    assert unpack(pack(item)) == item
    assert unpack(memoryview(pack(item))) == item


def test_layout() -> None:
    """The bytes are those of the table in the module."""
    raw = pack(Item(1, 2, 3, b"o" * 16, 4, 5, b"data"))
    assert raw == bytes([0] * 7 + [1] + [0] * 7 + [2] + [0] * 7 + [3]) + b"o" * 16 + b"\x04\x05data"


def test_too_short() -> None:
    """Fewer bytes than a head has are refused."""
    with pytest.raises(SealError) as caught:
        unpack(bytes(41))
    assert caught.value.reason is Refusal.TRUNCATED
