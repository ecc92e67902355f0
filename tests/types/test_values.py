"""The functions behind generated code."""

from __future__ import annotations

import array
import math
from decimal import Decimal
from typing import Any

import cbor2
import numpy as np
import orjson
import pytest

from ropeway.types import values
from ropeway.types.values import Misfit, Short


def test_scalars() -> None:
    """Numbers may be numpy's; a bool is no integer, though a float, and a number no bool."""
    assert (values.real(True), values.real(False)) == (1.0, 0.0)
    assert values.real(1) == values.real(np.float32(1)) == values.real(np.int8(1)) == 1.0
    assert math.isnan(values.real(None))
    assert values.whole(np.uint64(2**63)) == 2**63
    assert values.byte(b"\x05") == values.byte(np.uint8(5)) == 5
    assert values.truth(np.True_) is True
    misfits: list[tuple[Any, Any]] = [
        (values.real, "1"),
        (values.real, Decimal(1)),
        (values.whole, True),
        (values.whole, 1.0),
        (values.whole, np.float64(1)),
        (values.whole, np.array([1])),
        (values.byte, b"ab"),
        (values.truth, 1),
    ]
    for convert, value in misfits:
        with pytest.raises(Misfit):
            convert(value)


def test_times() -> None:
    """A time has the fields of ROS 2 or ROS 1, all of them optional, and no others."""
    assert values.time_parts({"sec": 1, "nanosec": 2}) == values.time_parts({"secs": 1, "nsecs": 2}) == (1, 2)
    assert values.time_parts({}) == (0, 0)
    assert values.time_parts({"sec": np.int32(3)}) == (3, 0)
    for value in (None, "now", [1, 2], {"sec": 1.0}, {"sec": True}, {"sec": 1, "more": 2}):
        with pytest.raises(Misfit):
            values.time_parts(value)


def test_octets() -> None:
    """Octets come from bytes, base64, lists, typed arrays and numpy."""
    given: list[Any] = [
        b"\1\2",
        bytearray(b"\1\2"),
        memoryview(b"\1\2"),
        "AQI=",
        "AQ\r\nI=",
        [1, 2],
        (1, 2),
        [b"\1", np.uint8(2)],
    ]
    given += [np.array([1, 2], np.uint8), np.array([1, 2]), cbor2.CBORTag(64, b"\1\2"), cbor2.CBORTag(65, b"\0\1\0\2")]
    for value in given:
        assert values.octets(value, 2, 0) == values.octets(value, -1, 2) == b"\1\2"
        with pytest.raises(Misfit):
            values.octets(value, 3, 0)
        with pytest.raises(Misfit):
            values.octets(value, -1, 1)
    bad: list[Any] = [
        "x",
        "\u00e9",
        [256],
        [-1],
        [1.5],
        [None],
        5,
        None,
        np.array([1.0]),
        np.array([256]),
        cbor2.CBORTag(64, 5),
    ]
    bad += [cbor2.CBORTag(1, b"\1"), cbor2.CBORTag(83, bytes(16)), cbor2.CBORTag(76, b""), {"a": 1}]
    for value in bad:
        with pytest.raises((Misfit, ValueError)):
            values.octets(value, -1, 0)


def test_numbers() -> None:
    """Numbers come from lists, arrays, bytes and typed arrays of any kind that loses nothing."""
    ints, floats = values.number_packer("h"), values.number_packer("d")
    given: list[Any] = [
        [1, 2],
        (1, 2),
        array.array("q", [1, 2]),
        b"\1\0\2\0",
        np.array([1, 2]),
        np.array([1, 2], ">i2"),
    ]
    given += [cbor2.CBORTag(77, b"\1\0\2\0"), cbor2.CBORTag(64, b"\1\2"), [np.int8(1), np.uint64(2)]]
    for value in given:
        assert ints(value, 2, 0) == b"\1\0\2\0"
    assert floats([1, None, np.float32(2)], -1, 0)[:8] == np.float64(1).tobytes()
    assert floats(np.array([1], "f4"), 1, 0) == floats(np.array([1], "i8"), 1, 0) == np.float64(1).tobytes()
    bad: list[Any] = [[1.5], [None], ["1"], [2**15], "AQI=", b"abc", np.array([1.0]), np.array([2**15]), 5, None, {}]
    bad += [
        cbor2.CBORTag(77, "x"),
        cbor2.CBORTag(77, b"abc"),
        cbor2.CBORTag(85, bytes(4)),
        cbor2.CBORTag(83, bytes(16)),
    ]
    for value in bad:
        with pytest.raises((Misfit, ValueError, OverflowError, TypeError)):
            ints(value, -1, 0)
    for value in (["1"], [True, "x"], np.array(["a"])):
        with pytest.raises(Misfit):
            floats(value, -1, 0)


def test_truths() -> None:
    """Bools come from lists, bytes of 0 and 1, and numpy."""
    for value in ([True, False], (np.True_, False), b"\1\0", np.array([True, False])):
        assert values.truths(value, 2, 0) == b"\1\0"
    for bad in ([1, 0], b"\2", np.array([1, 0]), "AQ==", None):
        with pytest.raises(Misfit):
            values.truths(bad, -1, 0)


def test_wide_text() -> None:
    """A wstring is UTF-16 in four bytes a unit, both ways."""
    coded = values.wide("a🚀", 3)
    assert len(coded) == 12
    assert values.read_wide(coded, 0, 3) == "a🚀"
    with pytest.raises(Misfit):
        values.wide("a🚀", 2)
    with pytest.raises(Misfit):
        values.wide(5, 0)
    with pytest.raises(Short):
        values.read_wide(b"\0\0\1\0", 0, 1)


def test_json_pieces() -> None:
    """Pieces of JSON are base64 texts and number lists of any length."""
    assert orjson.dumps(values.base64_text(b"xabcx", 1, 4)) == b'"YWJj"'
    raw = np.array([0.5, math.nan] * 40, "<f4").tobytes()
    for count in (2, 80):
        text = orjson.dumps(values.json_numbers(b"z" + raw, 1, count, "f"), option=orjson.OPT_SERIALIZE_NUMPY)
        assert orjson.loads(text) == [0.5, None] * (count // 2)


def test_lists_and_mappings() -> None:
    """Lists have the right length and mappings become dicts."""
    assert values.items((1, 2), 2, 0) == (1, 2)
    assert values.mapping(cbor2.loads(cbor2.dumps({"a": 1}))) == {"a": 1}
    for value in ("ab", {"a": 1}, None):
        with pytest.raises(Misfit):
            values.items(value, -1, 0)
    with pytest.raises(Misfit):
        values.mapping([1])
    with pytest.raises(Misfit):
        values.text(5, 0)
