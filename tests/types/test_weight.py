"""ropeway.types.weight."""

from __future__ import annotations

import os
import tracemalloc
from collections.abc import Callable

import cbor2
import orjson
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from ropeway.errors import InvalidFrame
from ropeway.limits import UNPACKED_BYTES, UNPACKED_PER_BYTE
from ropeway.types.untrusted import cbor_loads, json_loads
from ropeway.types.weight import check_cbor

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
        {"msg": [{"x": 1, "y": 2, "z": 3}] * 40_000},
        {"msg": [{"x": 1.5, "y": 2.5, "z": 0.1}] * 100_000},
        {"msg": [{"position": {"x": 0.1, "y": 0.2}, "name": "a text of some length", "ids": []}] * 20_000},
        {"msg": [0.1, 70_000, "ab", "", None, True] * 100_000},
        [[]] * 100_000,
    ],
    ids=["bytes", "bytes that look bad", "small maps", "points", "messages", "values", "some lists"],
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
        assert len(data) * 80 > max(UNPACKED_BYTES, UNPACKED_PER_BYTE * len(data))


MANY = 600_000


@pytest.mark.parametrize(
    "text",
    ["[" + "{}," * MANY + "1]", "[" + "[]," * MANY + "1]", "[" + '{"a":0},' * MANY + "1]", "[" + '"b",' * MANY + "1]",
     "{" + ",".join(f'"{n:x}":0' for n in range(MANY)) + "}", "[" + "[[0]]," * MANY + "1]"],
    ids=["empty objects", "empty lists", "small objects", "short texts", "many names", "nested"],
)  # fmt: skip
def test_json_bombs(text: str) -> None:
    """JSON that would take far more memory than it has bytes is refused before it is read, by its id if it has one."""
    data = f'{{"op":"call_service","id":"7","service":"/s","args":{text}}}'.encode()
    tracemalloc.start()
    try:
        with pytest.raises(InvalidFrame, match="in memory") as caught:
            json_loads(data)
        _, peak = tracemalloc.get_traced_memory()
    finally:
        tracemalloc.stop()
    assert peak < 4 * len(data)
    assert caught.value.message == {"op": "call_service", "id": "7", "service": "/s"}


@pytest.mark.parametrize(
    "value",
    [
        "x" * (4 << 20),
        "[{,:" * (1 << 20),
        [0] * 2_000_000,
        [-1, 100] * 500_000,
        [0.5] * 500_000,
        [1.234567] * 200_000,
        [{"x": 1.5, "y": 2.5, "z": 0.5}] * 100_000,
        [{"x": 0, "y": 0, "z": 0}] * 100_000,
        [{"header": {"stamp": {"sec": 5, "nanosec": 6}, "frame_id": "map"}, "pose": {"x": 0.5, "y": 1.25}}] * 30_000,
        [{f"field{n}": 1000 + n for n in range(20)}] * 5_000,
        ["a text"] * 200_000,
    ],
    ids=[
        "text", "brackets in a text", "map", "map with unknown", "halves", "ranges", "points", "whole points", "poses",
        "wide messages", "texts",
    ],
)  # fmt: skip
def test_json_messages(value: object) -> None:
    """What messages say is taken, however long it is, and read as it was written."""
    assert json_loads(orjson.dumps({"msg": value})) == {"msg": value}


def held_bytes(loads: Callable[[bytes], object], data: bytes) -> int:
    """Return how much memory what is read takes; nothing if it is refused."""
    tracemalloc.start()
    try:
        value = loads(data)
        taken, _ = tracemalloc.get_traced_memory()
        assert value
    except InvalidFrame:
        return 0
    finally:
        tracemalloc.stop()
    return taken


PIECES = ["{},", "[],", "0,", "0.5,", "12345,", '"b",', '{"a":0},', "[[0]],", '{"x":0,"y":0,"z":0},']


@pytest.mark.parametrize("size", [400_000, 1_000_000, pytest.param(3_000_000, marks=pytest.mark.slow)])
@pytest.mark.parametrize("piece", PIECES)
def test_what_json_takes(piece: str, size: int) -> None:
    """What is read takes no more memory than it may, whatever it is made of."""
    data = ("[" + piece * (size // len(piece)) + "0]").encode()
    assert held_bytes(json_loads, data) < 1.1 * max(UNPACKED_BYTES, UNPACKED_PER_BYTE * size)


CBOR_PIECES = [
    b"\x80",
    b"\xa0",
    b"\x81\0",
    b"\xa1\0\0",
    b"\0",
    b"\x19\x30\x39",
    b"\xfa\0\0\0\0",
    b"\x62ab",
    b"\x44abcd",
]


@pytest.mark.parametrize("size", [180_000, 1_000_000, pytest.param(3_000_000, marks=pytest.mark.slow)])
@pytest.mark.parametrize("piece", CBOR_PIECES, ids=lambda piece: piece.hex())
def test_what_cbor_takes(piece: bytes, size: int) -> None:
    """What is read takes no more memory than it may, whatever it is made of."""
    count = size // len(piece)
    data = b"\x9a" + count.to_bytes(4, "big") + piece * count
    assert held_bytes(cbor_loads, data) < 1.1 * max(UNPACKED_BYTES, UNPACKED_PER_BYTE * size)
