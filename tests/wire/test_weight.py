"""ropeway.wire.weight."""

from __future__ import annotations

import os
import tracemalloc

import cbor2
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from ropeway.errors import InvalidFrame
from ropeway.limits import UNPACKED_BYTES, UNPACKED_PER_BYTE
from ropeway.wire.frames import cbor_loads
from ropeway.wire.weight import check_cbor

COUNT = 1 << 20
HEAD = b"\x9a" + COUNT.to_bytes(4, "big")


@pytest.mark.parametrize(
    "data",
    [HEAD + item * COUNT for item in (b"\x80", b"\xa0", b"\x81", b"\x9f\xff", b"\x83\x01\x80\x80")],
    ids=["empty lists", "empty maps", "nested", "of no told length", "mixed"],
)  # fmt: skip
def test_bombs(data: bytes) -> None:
    """CBOR that would take far more memory than it has bytes is refused before it is read."""
    tracemalloc.start()
    try:
        with pytest.raises(InvalidFrame):
            cbor_loads(data)
        _, peak = tracemalloc.get_traced_memory()
    finally:
        tracemalloc.stop()
    assert peak < UNPACKED_BYTES


@pytest.mark.parametrize(
    "value",
    [
        {"msg": {"data": os.urandom(2 << 20)}},
        {"msg": {"data": b"\x80" * (2 << 20)}},
        {"msg": [{"x": 1, "y": 2, "z": 3}] * 100_000},
        {"msg": [{"position": {"x": 0.1, "y": 0.2}, "name": "a text of some length", "ids": []}] * 20_000},
        {"msg": [0.1, 70_000, "ab", "", None, True] * 100_000},
        [[]] * 100_000,
    ],
    ids=["bytes", "bytes that look bad", "small maps", "messages", "values", "some lists"],
)
def test_messages(value: object) -> None:
    """What messages say is taken, whatever bytes stand in it."""
    check_cbor(cbor2.dumps(value))


@settings(max_examples=50, deadline=None)
@given(st.binary(max_size=200), st.integers(3_000, 6_000))
def test_any_bytes(piece: bytes, times: int) -> None:
    """Whatever comes, it is let pass or refused, and what passes takes no more than it may."""
    data = piece * times
    try:
        check_cbor(data)
    except InvalidFrame:
        assert len(data) * 72 > max(UNPACKED_BYTES, UNPACKED_PER_BYTE * len(data))
