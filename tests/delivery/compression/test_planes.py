from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from ropeway.delivery.compression import planes
from ropeway.delivery.compression.arrays import BYTES, CONSTANT, NUMBERS, RECORDS, UPPER, Array


@pytest.mark.parametrize("kind", [np.uint8, np.uint16])
@pytest.mark.parametrize("words", [1, 2, 8191, 8192, 8193, 20_000])
def test_sums_of_small_numbers_are_right(kind: type, words: int) -> None:
    """Adding each number to the next, many at once, gives what adding one by one gives."""
    values: np.ndarray[Any, Any] = np.random.default_rng(words).integers(0, 256, words * 8, dtype=np.uint8).view(kind)
    for case in (values, np.full_like(values, np.iinfo(kind).max), np.zeros_like(values)):
        expected: np.ndarray[Any, Any] = np.cumsum(case, dtype=kind)
        result = case.copy()
        planes._add_left(result.view(np.uint64), 8 * values.itemsize)
        assert np.array_equal(result, expected)


@given(st.integers(1, 90), st.integers(1, 60), st.integers(0, 59))
def test_sums_of_rows_are_right(width: int, rows: int, rest: int) -> None:
    """Adding each row to the next, in blocks, gives what adding one by one gives, with part of a row at the end."""
    values = np.random.default_rng(width).integers(0, 256, width * rows + rest % width, dtype=np.uint8)
    expected = values.copy()
    for at in range(width):
        expected[at::width] = np.cumsum(values[at::width], dtype=np.uint8)
    planes._add_upper(values, width)
    assert np.array_equal(values, expected)


def test_the_upper_neighbour_is_used_where_it_helps() -> None:
    """A slanted plane takes it, noise does not."""
    rng = np.random.default_rng(0)
    y, x = np.mgrid[:100, :200]
    slope = (x * (y // 10) // 4 + x * x // 50).astype(np.uint16)
    noise = rng.integers(0, 50, 20_000).astype(np.uint16)
    for values, flag in ((slope, UPPER), (noise, 0)):
        assert planes.encode(values.tobytes(), Array(NUMBERS, 0, 20_000, width=200)).flags == flag
        data = values.astype(np.uint8).tobytes()
        assert planes.encode(data, Array(BYTES, 0, 20_000, width=200)).flags == flag


def test_columns_are_coded_as_they_are() -> None:
    """Constant columns cost no plane, slow ones are differences, random ones stay."""
    rng = np.random.default_rng(0)
    columns = np.empty((1000, 4), "<u4")
    columns[:, 0] = 7
    columns[:, 1] = np.cumsum(rng.integers(-40, 40, 1000)) + 100_000
    columns[:, 2] = rng.choice([0, 0x01020304, 0x99887766], 1000)
    columns[:, 3] = 5
    columns[1, 3] = 6
    parts = planes.encode(columns.tobytes(), Array(RECORDS, 0, 1000, width=16))
    assert parts.modes[:3] == bytes([CONSTANT, 1, 0])
    assert parts.modes[3] != CONSTANT
    assert parts.constants == b"\7\0\0\0"
    assert len(parts.planes) == 12
