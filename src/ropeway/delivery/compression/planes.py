"""Arrays to planes of small differences and back: the arithmetic of ``ropeway.delivery.compression.filters``.

``encode`` and ``decode`` compress and decompress the planes one by one, so that each has statistics of its own.
"""

from __future__ import annotations

import math
import threading
from collections.abc import Callable
from typing import Any, Final, NamedTuple, TypeAlias

import numpy as np
import numpy.typing as npt

from ropeway.delivery.compression import zstd
from ropeway.delivery.compression.arrays import BYTES, CONSTANT, GREEN, MIN_WIDTH, NUMBERS, UPPER, Array, Data
from ropeway.delivery.compression.zstd import Parameter, Strategy
from ropeway.errors import DecodeError

__all__ = ["EncodedArray", "decode", "encode"]

_U8: TypeAlias = npt.NDArray[np.uint8]
_U16: TypeAlias = npt.NDArray[np.uint16]
_U32: TypeAlias = npt.NDArray[np.uint32]
_U64: TypeAlias = npt.NDArray[np.uint64]

_KEPT_BYTES: Final = 8 << 20  # larger arrays are rare; a thread gives their memory back
_SAMPLE: Final = 256  # records looked at to choose how each column is coded

_RAW: Final = 0
_DELTA: Final = 1
_BIAS: Final = np.uint32(0x00808080)  # centres the lower bytes of small differences, so that the upper stay 0


class _Contexts(threading.local):
    """Holds what is costly to make and serves one thread at a time: compression contexts and working memory."""

    def __init__(self) -> None:
        # Differences repeat by chance only: a tiny match table leaves nearly all to the entropy coder, which on
        # the recordings gives both a better ratio and more speed than level 1.
        self.plane = zstd.Compressor(
            options={
                Parameter.window_log: 18,
                Parameter.hash_log: 6,
                Parameter.chain_log: 6,
                Parameter.search_log: 1,
                Parameter.min_match: 7,
                Parameter.target_length: 0,
                Parameter.strategy: Strategy.fast,
            }
        )
        self._memory: dict[str, _U8] = {}

    def array(self, name: str, shape: tuple[int, ...], dtype: npt.DTypeLike) -> npt.NDArray[Any]:
        """Return an array to work in, valid until the next one of this ``name``: fresh memory costs more
        than the work.
        """
        size = math.prod(shape) * np.dtype(dtype).itemsize
        memory = self._memory.get(name)
        if memory is None or memory.size < size:
            memory = np.empty(size, np.uint8)
            if size <= _KEPT_BYTES:
                self._memory[name] = memory
        return memory[:size].view(dtype).reshape(shape)


_contexts: Final = _Contexts()


class EncodedArray(NamedTuple):
    """An encoded array: flags, column modes and constants of records, and the compressed planes."""

    flags: int
    modes: bytes
    constants: bytes
    planes: list[bytes]


def encode(data: Data, array: Array) -> EncodedArray:
    """Take an array apart."""
    values = np.frombuffer(data, np.uint8, array.length, array.start)
    if array.filter == BYTES:
        return _encode_bytes(values.reshape(array.count, array.channels), array.width, array.green)
    if array.filter == NUMBERS:
        return _encode_numbers(values.view("<u2"), array.width)
    return _encode_records(values.reshape(array.count, array.width))


def decode(array: Array, flags: int, modes: Data, constants: Data, take: Callable[[], Data]) -> memoryview:
    """Put an array together; ``take`` gives one decompressed plane after the other, ``array.count`` bytes each.

    What it returns is valid until the next call in this thread. Raises ``DecodeError`` for an unknown column mode.
    """
    if array.filter == BYTES:
        values = _decode_bytes(array, flags, take)
    elif array.filter == NUMBERS:
        values = _decode_numbers(array, flags, take)
    else:
        values = _decode_records(array, modes, constants, take)
    return values.reshape(-1).data


def _compress(plane: _U8) -> bytes:
    return _contexts.plane.compress(plane.data)


def _encode_bytes(pixels: _U8, width: int, green: bool) -> EncodedArray:
    count, channels = pixels.shape
    planes: _U8 = _contexts.array("planes", (channels, count), np.uint8)
    for i in range(channels):
        np.copyto(planes[i], pixels[:, i])
    if green:
        planes[0] -= planes[1]
        planes[2] -= planes[1]
    deltas, upper = _differences(planes.reshape(-1), width)
    flags = (GREEN if green else 0) | (UPPER if upper else 0)
    return EncodedArray(flags, b"", b"", [_compress(plane) for plane in deltas.reshape(channels, count)])


def _encode_numbers(numbers: _U16, width: int) -> EncodedArray:
    values: _U16 = _contexts.array("planes", numbers.shape, np.uint16)
    np.copyto(values, numbers)
    deltas, upper = _differences(values, width)
    signs = values if deltas is not values else _contexts.array("deltas", numbers.shape, np.uint16)
    np.right_shift(deltas.view(np.int16), 15, out=signs.view(np.int16))  # all ones where negative
    deltas <<= 1
    deltas ^= signs
    return EncodedArray(UPPER if upper else 0, b"", b"", _byte_planes(deltas.view(np.uint8).reshape(-1, 2)))


def _byte_planes(rows: _U8) -> list[bytes]:
    plane: _U8 = _contexts.array("plane", rows.shape[:1], np.uint8)
    frames: list[bytes] = []
    for i in range(rows.shape[1]):
        np.copyto(plane, rows[:, i])
        frames.append(_compress(plane))
    return frames


def _differences(values: npt.NDArray[Any], width: int) -> tuple[npt.NDArray[Any], bool]:
    """Subtract from each value its left neighbour, and from that the same of the row above if it helps; reuses
    ``values``.

    The rows of all planes follow each other as if they were one image.
    """
    deltas = _contexts.array("deltas", values.shape, values.dtype)
    _take_off(values, 1, deltas)
    if not _upper_helps(deltas, width):
        return deltas, False
    _take_off(deltas, width, values)
    return values, True


def _take_off(values: npt.NDArray[Any], distance: int, out: npt.NDArray[Any]) -> None:
    out[:distance] = values[:distance]
    np.subtract(values[distance:], values[:-distance], out=out[distance:])


def _upper_helps(deltas: npt.NDArray[Any], width: int) -> bool:
    """Return whether differences to the row above are smaller than differences to the left, judged by a few rows."""
    rows = deltas.size // width if width >= MIN_WIDTH else 0
    if rows < 2:
        return False
    grid = deltas[: rows * width].reshape(rows, width)
    sample = np.arange(1, rows, max(1, rows // 12))
    left = grid[sample]
    both = left - grid[sample - 1]
    if deltas.dtype == np.uint16:
        left, both = (np.minimum(np.minimum(x, -x), 127).astype(np.uint8) for x in (left, both))
    return bool(_BITS[both].sum() < _BITS[left].sum())


# about how many bits a difference costs, by its lowest byte
_BITS: Final = np.log2(1 + np.abs(np.arange(256, dtype=np.uint8).view(np.int8).astype(np.float32)))


def _encode_records(records: _U8) -> EncodedArray:
    count, step = records.shape
    columns = _columns(records)
    modes = _choose_modes(columns)
    column: _U32 = _contexts.array("planes", (count,), "<u4")
    delta: _U32 = _contexts.array("deltas", (count,), "<u4")
    constants: list[bytes] = []
    frames: list[bytes] = []
    for index, mode in enumerate(modes):
        np.copyto(column, columns[:, index])
        if mode == CONSTANT:
            if (column == column[0]).all():
                constants.append(column[:1].tobytes())
                continue
            modes[index] = _RAW
        elif mode == _DELTA:
            delta[0] = column[0]
            np.subtract(column[1:], column[:-1], out=delta[1:])
            delta += _BIAS
        frames += _byte_planes((delta if mode == _DELTA else column).view(np.uint8).reshape(count, 4))
    frames += _byte_planes(records[:, step & ~3 :])
    return EncodedArray(0, bytes(modes), b"".join(constants), frames)


def _columns(records: _U8) -> _U32:
    count, step = records.shape
    columns: _U32 = np.ndarray((count, step // 4), "<u4", records, strides=(step, 4))
    return columns


def _choose_modes(columns: _U32) -> bytearray:
    """Choose for each column the mode that gives its bytes the least entropy, judged by a sample of the records."""
    count = len(columns)
    sample = np.linspace(1, count - 1, _SAMPLE, dtype=np.intp)
    raw = np.ascontiguousarray(columns[sample])
    delta = raw - columns[sample - 1] + _BIAS
    constant = (raw == raw[0]).all(axis=0)
    # what differences gain must outweigh that they hide repetitions from the compressor
    differ = _entropy(delta) < np.float32(0.93) * _entropy(raw)
    return bytearray(np.where(constant, CONSTANT, np.where(differ, _DELTA, _RAW)).astype(np.uint8))


def _entropy(sample: _U32) -> npt.NDArray[np.float32]:
    """Return the bits of an average record in each column, its four bytes taken as independent."""
    width = sample.shape[1]
    shifted = sample.view(np.uint8) + np.arange(0, 1024 * width, 256)
    histograms = np.bincount(shifted.ravel(), minlength=1024 * width).reshape(width, 1024)
    order: npt.NDArray[np.float32] = _N_LOG_N[histograms].sum(axis=1)
    bits: npt.NDArray[np.float32] = np.float32(4 * math.log2(_SAMPLE)) - order / np.float32(_SAMPLE)
    return bits


_N_LOG_N: Final = np.array([0, *(n * math.log2(n) for n in range(1, _SAMPLE + 1))], np.float32)


def _plane(take: Callable[[], Data]) -> _U8:
    return np.frombuffer(take(), np.uint8)


def _decode_bytes(array: Array, flags: int, take: Callable[[], Data]) -> _U8:
    channels, count = array.channels, array.count
    padded: _U8 = _contexts.array("planes", (_padded(channels * count),), np.uint8)
    values = padded[: channels * count]
    planes = values.reshape(channels, count)
    for plane in planes:
        plane[:] = _plane(take)
    if flags & UPPER:
        _add_upper(values, array.width)
    _add_left(padded.view(np.uint64), 8)
    if flags & GREEN:
        planes[0] += planes[1]
        planes[2] += planes[1]
    if channels == 1:
        return values
    pixels: _U8 = _contexts.array("pixels", (count, channels), np.uint8)
    for i in range(channels):
        np.copyto(pixels[:, i], planes[i])
    return pixels


def _decode_numbers(array: Array, flags: int, take: Callable[[], Data]) -> _U8:
    count = array.count
    folded: _U16 = _contexts.array("planes", (_padded(count),), np.uint16)
    numbers: _U16 = _contexts.array("pixels", (_padded(count),), np.uint16)
    planes = folded.view(np.uint8).reshape(-1, 2)
    planes[:count, 0] = _plane(take)
    planes[:count, 1] = _plane(take)
    np.right_shift(folded, 1, out=numbers)
    folded &= 1
    np.negative(folded, out=folded)
    numbers ^= folded
    if flags & UPPER:
        _add_upper(numbers[:count], array.width)
    _add_left(numbers.view(np.uint64), 16)
    return numbers[:count].view(np.uint8)


def _decode_records(array: Array, modes: Data, constants: Data, take: Callable[[], Data]) -> _U8:
    count, step = array.count, array.width
    records: _U8 = _contexts.array("pixels", (count, step), np.uint8)
    columns = _columns(records)
    column: _U32 = _contexts.array("planes", (count,), "<u4")
    planes = column.view(np.uint8).reshape(count, 4)
    known = iter(np.frombuffer(constants, "<u4"))
    for index, mode in enumerate(modes):
        if mode == CONSTANT:
            columns[:, index] = next(known)
            continue
        if mode > _DELTA:
            raise DecodeError("message", "zstd", f"there is no column mode {mode}")
        for i in range(4):
            planes[:, i] = _plane(take)
        if mode == _DELTA:
            np.subtract(column, _BIAS, out=column)
            np.add.accumulate(column, out=columns[:, index])
        else:
            columns[:, index] = column
    for i in range(step & ~3, step):
        records[:, i] = _plane(take)
    return records


def _padded(count: int) -> int:
    return (count + 7) & ~7


def _add_upper(values: npt.NDArray[Any], width: int) -> None:
    """Add to each row the row before, in place: in blocks of rows side by side, then the blocks one to the next."""
    count = values.size
    rows = count // width
    block = math.isqrt(rows)
    blocks = rows // block
    grid = values[: blocks * block * width].reshape(blocks, block, width)
    for i in range(1, block):
        np.add(grid[:, i], grid[:, i - 1], out=grid[:, i])
    for i in range(1, blocks):
        np.add(grid[i], grid[i - 1, block - 1], out=grid[i])
    for start in range(blocks * block * width, count, width):
        row = values[start : start + width]
        np.add(row, values[start - width : start - width + row.size], out=row)


class _Lanes(NamedTuple):
    """Describes how small numbers lie in 64-bit words; every second one is masked out, so that sums have room."""

    width: np.uint64
    mask: np.uint64
    ones: np.uint64
    last: np.uint64
    low: np.uint64


_LANES: Final = {
    8: _Lanes(*map(np.uint64, (8, 0x00FF00FF00FF00FF, 0x0001000100010001, 48, 0xFF))),
    16: _Lanes(*map(np.uint64, (16, 0x0000FFFF0000FFFF, 0x0000000100000001, 32, 0xFFFF))),
}
_CHUNK: Final = 8192  # words of one step, so that all stay in the second-level cache


def _add_left(words: _U64, bits: int) -> None:
    """Add to each number of ``bits`` the one before, in place.

    Does what ``np.add.accumulate`` does for small numbers, three times faster: the sums within a word by one
    multiplication, those over words by accumulating whole words.
    """
    width, mask, ones, last, low = _LANES[bits]
    size = min(_CHUNK, words.size)
    scratch: _U64 = _contexts.array("lanes", (3, size + 1), np.uint64)
    scratch[2, 0] = 0
    for start in range(0, words.size, _CHUNK):
        word = words[start : start + _CHUNK]
        odd, sums, before = scratch[:, : word.size]
        np.right_shift(word, width, out=odd)
        np.bitwise_and(odd, mask, out=odd)
        np.bitwise_and(word, mask, out=sums)
        np.add(sums, odd, out=sums)
        np.multiply(sums, ones, out=sums)  # each lane: all pairs up to it
        ends = scratch[2, 1 : word.size + 1]
        np.right_shift(sums, last, out=ends)
        ends[0] += before[0]
        np.add.accumulate(ends, out=ends)
        np.bitwise_and(before, low, out=word)
        np.multiply(word, ones, out=word)
        np.add(sums, word, out=sums)
        before[0] = ends[-1]
        np.subtract(sums, odd, out=odd)  # the even ones: less their odd neighbour
        np.bitwise_and(odd, mask, out=odd)
        np.bitwise_and(sums, mask, out=sums)
        np.left_shift(sums, width, out=sums)
        np.bitwise_or(sums, odd, out=word)
