"""The ``zstd`` body: a reversible filter where the type allows one, then zstandard.

Compressors find little in camera images and point clouds, whose neighbours are nearly but not exactly equal. A
filter turns them into small differences, sorted into planes, one zstandard frame for each. The body says how to
invert itself, so that ``decode`` needs no type and no registry. Its first byte is one of

====  ========================================================================================================
0     stored: the payload as it is, where nothing helped
1     plain: one zstandard frame of the payload
2     bytes: 1 to 4 channels, green taken from red and blue, the left (and upper) neighbour taken off, one plane
      for each channel
3     16-bit numbers: the left (and upper) neighbour taken off, signs folded; low bytes, then high bytes
4     records of ``width`` bytes: each 32-bit column constant, as it is, or with the record before taken off; one
      plane for each byte of the record that is not constant
====  ========================================================================================================

Filters 2 to 4 go on with a header (``_HEADER``), the column modes and constants of filter 4, the bytes of the
payload before and after the filtered array, and the planes, each a 32-bit length and a zstandard frame that states
its size. All numbers are little-endian. Every payload comes back bit by bit, also one that is no valid message of
its type: what a filter does not understand lies outside its array.
"""

from __future__ import annotations

import math
import struct
import threading
from collections.abc import Callable
from typing import Any, Final, NamedTuple, TypeAlias

import numpy as np
import numpy.typing as npt
import zstandard

from ropeway.errors import DecodeError, MessageTooBig

__all__ = ["LIMIT_BYTES", "decode", "encode"]

Data: TypeAlias = bytes | bytearray | memoryview
_U8: TypeAlias = npt.NDArray[np.uint8]
_U16: TypeAlias = npt.NDArray[np.uint16]
_U32: TypeAlias = npt.NDArray[np.uint32]
_U64: TypeAlias = npt.NDArray[np.uint64]

LIMIT_BYTES: Final = 64 << 20
"""The largest payload that ``decode`` makes unless told otherwise."""

_STORED: Final = b"\0"
_PLAIN: Final = b"\1"
_BYTES: Final = 2
_NUMBERS: Final = 3
_RECORDS: Final = 4

_HEADER: Final = struct.Struct("<BBBxIIII")  # filter, channels, flags, head length, tail length, width, count
_LENGTH: Final = struct.Struct("<I")
_GREEN: Final = 1  # flag: channel 1 is taken from channels 0 and 2
_UPPER: Final = 2  # flag: the upper neighbour's difference is taken off as well

_MIN_COUNT: Final = 256  # below that the planes' own headers cost more than a filter gains
_MIN_WIDTH: Final = 64  # of rows with the upper flag; bounds the loops over rows by the size of the data
_MAX_STEP: Final = 256  # bytes of a record
_SAMPLE: Final = 256  # records looked at to choose how each column is coded
_KEPT_BYTES: Final = 8 << 20  # larger arrays are rare; a thread gives their memory back

_RAW: Final = 0
_DELTA: Final = 1
_CONSTANT: Final = 2
_BIAS: Final = np.uint32(0x00808080)  # centres the lower bytes of small differences, so that the upper stay 0


class _Contexts(threading.local):
    """What is costly to make and serves one thread at a time: compression contexts and working memory."""

    def __init__(self) -> None:
        self.plain = zstandard.ZstdCompressor(level=1)
        # Differences repeat by chance only: a tiny match table leaves nearly all to the entropy coder, which on
        # the recordings gives both a better ratio and more speed than level 1.
        self.plane = zstandard.ZstdCompressor(
            compression_params=zstandard.ZstdCompressionParameters(
                window_log=18,
                hash_log=6,
                chain_log=6,
                search_log=1,
                min_match=7,
                target_length=0,
                strategy=zstandard.STRATEGY_FAST,
            )
        )
        self.decompressor = zstandard.ZstdDecompressor()
        self._memory: dict[str, _U8] = {}

    def array(self, name: str, shape: tuple[int, ...], dtype: npt.DTypeLike) -> npt.NDArray[Any]:
        """An array to work in, valid until the next one of this ``name``: fresh memory costs more than the work."""
        size = math.prod(shape) * np.dtype(dtype).itemsize
        memory = self._memory.get(name)
        if memory is None or memory.size < size:
            memory = np.empty(size, np.uint8)
            if size <= _KEPT_BYTES:
                self._memory[name] = memory
        return memory[:size].view(dtype).reshape(shape)


_contexts: Final = _Contexts()


# --- encoding ---------------------------------------------------------------------------------------------------


def encode(payload: Data, type: str) -> bytes:
    """The ``zstd`` body of a CDR payload of the message ``type`` (``pkg/msg/Name``); any bytes are accepted."""
    find = _FINDERS.get(type)
    array = find(payload) if find is not None else None
    if array is None:
        frame = _contexts.plain.compress(payload)
        return _PLAIN + frame if len(frame) < len(payload) else _STORED + payload
    parts = array.encode(np.frombuffer(payload, np.uint8, array.length, array.start))
    used = array.start + array.count * array.width_bytes
    head, tail = payload[: array.start], payload[used:]
    header = _HEADER.pack(array.filter, array.channels, parts.flags, len(head), len(tail), array.width, array.count)
    size = len(header) + len(parts.extra) + len(head) + len(tail) + sum(map(len, parts.frames)) + 4 * len(parts.frames)
    if size >= len(payload):
        return _STORED + payload
    pieces: list[Data] = [header, parts.extra, head, tail]
    for frame in parts.frames:
        pieces += (_LENGTH.pack(len(frame)), frame)
    return b"".join(pieces)


class _Parts(NamedTuple):
    flags: int
    extra: bytes
    frames: list[bytes]


class _Array(NamedTuple):
    """Where in a payload lies what a filter knows: ``count`` elements of ``width_bytes`` from ``start``."""

    filter: int
    start: int
    count: int
    channels: int = 1
    width: int = 0  # elements of a row, or bytes of a record
    green: bool = False

    @property
    def width_bytes(self) -> int:
        return (self.channels, 2, self.width)[self.filter - _BYTES]

    @property
    def length(self) -> int:
        return self.count * self.width_bytes

    def encode(self, data: _U8) -> _Parts:
        if self.filter == _BYTES:
            return _encode_bytes(data.reshape(self.count, self.channels), self.width, self.green)
        if self.filter == _NUMBERS:
            return _encode_numbers(data.view("<u2"), self.width)
        return _encode_records(data.reshape(self.count, self.width))


def _encode_bytes(pixels: _U8, width: int, green: bool) -> _Parts:
    count, channels = pixels.shape
    planes: _U8 = _contexts.array("planes", (channels, count), np.uint8)
    for i in range(channels):
        np.copyto(planes[i], pixels[:, i])
    if green:
        planes[0] -= planes[1]
        planes[2] -= planes[1]
    deltas, upper = _differences(planes.reshape(-1), width)
    compress = _contexts.plane.compress
    return _Parts((green and _GREEN) | (upper and _UPPER), b"", [compress(x) for x in deltas.reshape(channels, count)])


def _encode_numbers(numbers: _U16, width: int) -> _Parts:
    values: _U16 = _contexts.array("planes", numbers.shape, np.uint16)
    np.copyto(values, numbers)
    deltas, upper = _differences(values, width)
    signs = values if deltas is not values else _contexts.array("deltas", numbers.shape, np.uint16)
    np.right_shift(deltas.view(np.int16), 15, out=signs.view(np.int16))  # all ones where negative
    deltas <<= 1
    deltas ^= signs
    return _Parts(upper and _UPPER, b"", _byte_planes(deltas.view(np.uint8).reshape(-1, 2)))


def _byte_planes(rows: _U8) -> list[bytes]:
    compress = _contexts.plane.compress
    plane: _U8 = _contexts.array("plane", rows.shape[:1], np.uint8)
    frames: list[bytes] = []
    for i in range(rows.shape[1]):
        np.copyto(plane, rows[:, i])
        frames.append(compress(plane))
    return frames


def _differences(values: npt.NDArray[Any], width: int) -> tuple[npt.NDArray[Any], bool]:
    """Each value less its left neighbour, and that less the same of the row above if it helps; reuses ``values``.

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
    """Whether rows differ less from each other's left differences than those are large; looks at a few rows."""
    rows = deltas.size // width if width >= _MIN_WIDTH else 0
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


def _encode_records(records: _U8) -> _Parts:
    count, step = records.shape
    columns = _columns(records)
    modes = _choose_modes(columns)
    column: _U32 = _contexts.array("planes", (count,), "<u4")
    delta: _U32 = _contexts.array("deltas", (count,), "<u4")
    constants: list[bytes] = []
    frames: list[bytes] = []
    for index, mode in enumerate(modes):
        np.copyto(column, columns[:, index])
        if mode == _CONSTANT:
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
    return _Parts(0, bytes(modes) + b"".join(constants), frames)


def _columns(records: _U8) -> _U32:
    count, step = records.shape
    return np.ndarray((count, step // 4), "<u4", records, strides=(step, 4))


def _choose_modes(columns: _U32) -> bytearray:
    """The mode of each column that gives its bytes the least entropy, by a sample of the records."""
    count, width = columns.shape
    sample = np.linspace(1, count - 1, _SAMPLE, dtype=np.intp)
    raw = np.ascontiguousarray(columns[sample])
    delta = raw - columns[sample - 1] + _BIAS
    constant = (raw == raw[0]).all(axis=0)
    # what differences gain must outweigh that they hide repetitions from the compressor
    differ = _entropy(delta) < np.float32(0.93) * _entropy(raw)
    return bytearray(np.where(constant, _CONSTANT, np.where(differ, _DELTA, _RAW)).astype(np.uint8))


def _entropy(sample: _U32) -> npt.NDArray[np.float32]:
    """The bits of an average record in each column, its four bytes taken as independent."""
    width = sample.shape[1]
    shifted = sample.view(np.uint8) + np.arange(0, 1024 * width, 256)
    histograms = np.bincount(shifted.ravel(), minlength=1024 * width).reshape(width, 1024)
    return 4 * np.float32(math.log2(_SAMPLE)) - _N_LOG_N[histograms].sum(axis=1) / np.float32(_SAMPLE)


_N_LOG_N: Final = np.array([0, *(n * math.log2(n) for n in range(1, _SAMPLE + 1))], np.float32)


# --- finding the arrays -----------------------------------------------------------------------------------------

_HEADER_STAMP_END: Final = 12  # the CDR header and a std_msgs/Header's stamp
_U32_1: Final = struct.Struct("<I")
_U32_2: Final = struct.Struct("<II")
_U32_3: Final = struct.Struct("<III")

_CHANNELS: Final[dict[bytes, tuple[int, bool]]] = {
    # what a pixel is made of, and whether channel 1 is green
    b"mono8": (1, False),
    b"8UC1": (1, False),
    b"8SC1": (1, False),
    b"8UC2": (2, False),
    b"8UC3": (3, True),
    b"8UC4": (4, True),
    b"rgb8": (3, True),
    b"bgr8": (3, True),
    b"rgba8": (4, True),
    b"bgra8": (4, True),
    # two columns repeat: the nearest pixel of the same colour is two away
    b"bayer_rggb8": (2, False),
    b"bayer_bggr8": (2, False),
    b"bayer_gbrg8": (2, False),
    b"bayer_grbg8": (2, False),
    # two pixels share their colour: luma, U, luma, V
    b"yuv422": (4, False),
    b"yuv422_yuy2": (4, False),
    b"uyvy": (4, False),
    b"yuyv": (4, False),
}
_NUMBERS_16: Final = frozenset((b"mono16", b"16UC1", b"16SC1"))
_NUMBERS_32: Final = frozenset((b"32FC1", b"32SC1"))


def _aligned(offset: int) -> int:
    return (offset + 3) & ~3


def _after_string(payload: Data, offset: int) -> int:
    (length,) = _U32_1.unpack_from(payload, offset)
    return _aligned(offset + 4 + int(length))


def _find_image(payload: Data) -> _Array | None:
    """The pixels of a sensor_msgs/Image."""
    try:
        offset = _after_string(payload, _HEADER_STAMP_END)  # frame_id
        _, _, length = _U32_3.unpack_from(payload, offset)  # height, width, length of the encoding with its NUL
        end = offset + 12 + length
        encoding = bytes(payload[offset + 12 : end - 1]) if length <= 32 else b""
        big_endian = payload[end]
        step, size = _U32_2.unpack_from(payload, _aligned(end + 1))
    except (struct.error, IndexError):
        return None
    start = _aligned(end + 1) + 8
    if start + size > len(payload):
        return None
    if encoding in _CHANNELS:
        channels, green = _CHANNELS[encoding]
        array = _Array(_BYTES, start, size // channels, channels, step // channels, green)
    elif encoding in _NUMBERS_16 and not big_endian:
        array = _Array(_NUMBERS, start, size // 2, width=step // 2)
    elif encoding in _NUMBERS_32:
        array = _Array(_RECORDS, start, size // 4, width=4)
    else:
        return None
    return array if array.count >= _MIN_COUNT else None


def _find_cloud(payload: Data) -> _Array | None:
    """The points of a sensor_msgs/PointCloud2."""
    try:
        offset = _after_string(payload, _HEADER_STAMP_END)  # frame_id
        _, _, fields = _U32_3.unpack_from(payload, offset)  # height, width, number of fields
        if fields > _MAX_STEP:
            return None
        offset += 12
        for _ in range(fields):
            offset = _aligned(_after_string(payload, offset) + 5) + 4  # name, offset, datatype, count
        offset = _aligned(offset + 1)  # is_bigendian
        step, _, size = _U32_3.unpack_from(payload, offset)  # point_step, row_step, length of the data
    except (struct.error, IndexError):
        return None
    start = offset + 12
    if start + size > len(payload) or not 4 <= step <= _MAX_STEP or size // step < _MIN_COUNT:
        return None
    return _Array(_RECORDS, start, size // step, width=step)


_FINDERS: Final[dict[str, Callable[[Data], _Array | None]]] = {
    "sensor_msgs/msg/Image": _find_image,
    "sensor_msgs/msg/PointCloud2": _find_cloud,
}


# --- decoding ---------------------------------------------------------------------------------------------------


def decode(body: Data, limit_bytes: int = LIMIT_BYTES) -> bytes:
    """The payload of a ``zstd`` body.

    Raises ``DecodeError`` for bytes that ``encode`` does not make, ``MessageTooBig`` where the payload would be
    above ``limit_bytes``.
    """
    kind = body[0] if len(body) else -1
    if kind == _STORED[0]:
        if len(body) - 1 > limit_bytes:
            raise MessageTooBig(len(body) - 1, limit_bytes)
        return bytes(body[1:])
    if kind == _PLAIN[0]:
        return _decompress(body[1:], None, limit_bytes)
    if kind not in (_BYTES, _NUMBERS, _RECORDS):
        raise _error(f"there is no filter {kind}")
    if len(body) < _HEADER.size:
        raise _error("it ends in its header")
    _, channels, flags, head, tail, width, count = _HEADER.unpack_from(body)
    array = _Array(kind, head, count, channels, width)
    _check(array, flags)
    total = head + array.length + tail
    if total > limit_bytes:
        raise MessageTooBig(total, limit_bytes)
    cursor = _Cursor(body, _HEADER.size)
    if kind == _RECORDS:
        modes = cursor.take(width // 4)
        constants = cursor.take(4 * bytes(modes).count(_CONSTANT))
        around = cursor.take(head), cursor.take(tail)
        data = _decode_records(array, modes, constants, cursor)
    else:
        around = cursor.take(head), cursor.take(tail)
        data = _decode_bytes(array, flags, cursor) if kind == _BYTES else _decode_numbers(array, flags, cursor)
    cursor.finish()
    return b"".join((around[0], data.reshape(-1).data, around[1]))


def _check(array: _Array, flags: int) -> None:
    if array.count < 1 or not 1 <= array.channels <= 4 or flags > (_GREEN | _UPPER):
        raise _error("its header is not one of ours")
    if flags & _GREEN and array.channels < 3:
        raise _error("green without red and blue")
    if flags & _UPPER and not _MIN_WIDTH <= array.width <= array.count:
        raise _error(f"rows of {array.width} elements")
    if array.filter == _RECORDS and not 4 <= array.width <= _MAX_STEP:
        raise _error(f"records of {array.width} bytes")


class _Cursor:
    """Reads a body from front to back."""

    __slots__ = ("_body", "_offset")

    def __init__(self, body: Data, offset: int) -> None:
        self._body = memoryview(body)
        self._offset = offset

    def take(self, length: int) -> memoryview:
        start = self._offset
        self._offset = end = start + length
        if end > len(self._body):
            raise _error("it is cut off")
        return self._body[start:end]

    def plane(self, size: int) -> _U8:
        (length,) = _LENGTH.unpack(self.take(4))
        return np.frombuffer(_decompress(self.take(length), size, size), np.uint8)

    def finish(self) -> None:
        if self._offset != len(self._body):
            raise _error(f"{len(self._body) - self._offset} bytes follow its end")


def _decompress(frame: Data, size: int | None, limit_bytes: int) -> bytes:
    """What a frame holds, which must be ``size`` bytes (``None``: at most ``limit_bytes``)."""
    try:
        stated = zstandard.frame_content_size(frame)
        if stated < 0:
            raise _error("a frame does not state its size")
        if size is not None and stated != size:
            raise _error(f"a plane has {stated} bytes, not {size}")
        if stated > limit_bytes:
            raise MessageTooBig(stated, limit_bytes)
        return _contexts.decompressor.decompress(frame, allow_extra_data=False)
    except zstandard.ZstdError as error:
        raise _error(str(error)) from error


def _error(reason: str) -> DecodeError:
    return DecodeError("message", "zstd", reason)


def _decode_bytes(array: _Array, flags: int, cursor: _Cursor) -> _U8:
    channels, count = array.channels, array.count
    padded: _U8 = _contexts.array("planes", (_padded(channels * count),), np.uint8)
    values = padded[: channels * count]
    planes = values.reshape(channels, count)
    for plane in planes:
        plane[:] = cursor.plane(count)
    if flags & _UPPER:
        _add_upper(values, array.width)
    _add_left(padded.view(np.uint64), 8)
    if flags & _GREEN:
        planes[0] += planes[1]
        planes[2] += planes[1]
    if channels == 1:
        return values
    pixels: _U8 = _contexts.array("pixels", (count, channels), np.uint8)
    for i in range(channels):
        np.copyto(pixels[:, i], planes[i])
    return pixels


def _decode_numbers(array: _Array, flags: int, cursor: _Cursor) -> _U8:
    count = array.count
    folded: _U16 = _contexts.array("planes", (_padded(count),), np.uint16)
    numbers: _U16 = _contexts.array("pixels", (_padded(count),), np.uint16)
    planes = folded.view(np.uint8).reshape(-1, 2)
    planes[:count, 0] = cursor.plane(count)
    planes[:count, 1] = cursor.plane(count)
    np.right_shift(folded, 1, out=numbers)
    folded &= 1
    np.negative(folded, out=folded)
    numbers ^= folded
    if flags & _UPPER:
        _add_upper(numbers[:count], array.width)
    _add_left(numbers.view(np.uint64), 16)
    return numbers[:count].view(np.uint8)


def _decode_records(array: _Array, modes: memoryview, constants: memoryview, cursor: _Cursor) -> _U8:
    count, step = array.count, array.width
    records: _U8 = _contexts.array("pixels", (count, step), np.uint8)
    columns = _columns(records)
    column: _U32 = _contexts.array("planes", (count,), "<u4")
    planes = column.view(np.uint8).reshape(count, 4)
    known = iter(np.frombuffer(constants, "<u4"))
    for index, mode in enumerate(modes):
        if mode == _CONSTANT:
            columns[:, index] = next(known)
            continue
        if mode > _DELTA:
            raise _error(f"there is no column mode {mode}")
        for i in range(4):
            planes[:, i] = cursor.plane(count)
        if mode == _DELTA:
            np.subtract(column, _BIAS, out=column)
            np.add.accumulate(column, out=columns[:, index])
        else:
            columns[:, index] = column
    for i in range(step & ~3, step):
        records[:, i] = cursor.plane(count)
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
    """How small numbers lie in 64-bit words, seen with every second one masked out, so that sums have room."""

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
