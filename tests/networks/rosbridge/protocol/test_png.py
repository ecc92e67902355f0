from __future__ import annotations

import struct
import zlib
from contextlib import suppress

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from ropeway.errors import DecodeError, MessageTooBig
from ropeway.networks.rosbridge.protocol.png import pack, unpack

LIMIT = 1 << 20


def chunk(kind: bytes, data: bytes) -> bytes:
    """One PNG chunk."""
    return struct.pack(">I", len(data)) + kind + data + struct.pack(">I", zlib.crc32(kind + data))


def image(width: int, height: int, rows: bytes, form: tuple[int, ...] = (8, 2, 0, 0, 0)) -> bytes:
    """A PNG with these filtered rows, in two parts."""
    data = zlib.compress(rows)
    header = struct.pack(">II5B", width, height, *form)
    return b"\x89PNG\r\n\x1a\n" + b"".join(
        (
            chunk(b"IHDR", header),
            chunk(b"tEXt", b"x\0y"),
            chunk(b"IDAT", data[:5]),
            chunk(b"IDAT", data[5:]),
            chunk(b"IEND", b""),
        )
    )


def filtered(number: int, row: bytes, above: bytes) -> bytes:
    """A row as the filter of this number makes it, by the book."""
    out = bytearray([number])
    for i, value in enumerate(row):
        a, b, c = (row[i - 3] if i >= 3 else 0), above[i], (above[i - 3] if i >= 3 else 0)
        p = a + b - c
        paeth = min((abs(p - a), 0, a), (abs(p - b), 1, b), (abs(p - c), 2, c))[2]
        out.append((value - (0, a, b, (a + b) // 2, paeth)[number]) & 255)
    return bytes(out)


@pytest.mark.parametrize("size", [0, 1, 2, 3, 4, 11, 12, 13, 1000, 100_000])
def test_a_text_comes_back(size: int) -> None:
    """Texts of every size are restored without the padding."""
    text = bytes(range(33, 127)) * (size // 94 + 1)
    assert unpack(pack(text[:size]), limit_bytes=LIMIT) == text[:size]


def test_the_image_is_as_rosbridge_makes_it() -> None:
    """It is RGB of 8 bits, as wide as the root of a third of the text, padded with line feeds."""
    text = b"x" * 1000
    data = pack(text)
    width, height, depth, colour, *rest = struct.unpack_from(">II5B", data, 16)
    assert (width, height, depth, colour, rest) == (18, 19, 8, 2, [0, 0, 0])
    length = struct.unpack_from(">I", data, 33)[0]
    rows = zlib.decompress(data[41 : 41 + length])
    assert rows == b"".join(b"\0" + text.ljust(18 * 19 * 3, b"\n")[at : at + 54] for at in range(0, 18 * 19 * 3, 54))


@given(st.lists(st.sampled_from(range(5)), min_size=1, max_size=12), st.integers(1, 9), st.randoms())
def test_every_filter_is_undone(numbers: list[int], width: int, random: object) -> None:
    """Rows that another encoder filtered are restored."""
    pixels = [random.randbytes(3 * width) for _ in numbers]  # type: ignore[attr-defined]
    pixels[-1] = pixels[-1][:-1] + b"}"
    rows, above = b"", bytes(3 * width)
    for number, row in zip(numbers, pixels, strict=True):
        rows += filtered(number, row, above)
        above = row
    assert unpack(image(width, len(numbers), rows), limit_bytes=LIMIT) == b"".join(pixels)


GOOD = b"\0abc\0def"
BAD = {
    "nothing": b"",
    "only a signature": b"\x89PNG\r\n\x1a\n",
    "no header": b"\x89PNG\r\n\x1a\n" + chunk(b"IEND", b""),
    "another form": image(1, 2, GOOD, (8, 6, 0, 0, 0)),
    "no pixels": image(0, 2, GOOD),
    "too few pixels": image(1, 3, GOOD),
    "too many pixels": image(1, 1, GOOD),
    "an unknown filter": image(1, 2, b"\5abc\0def"),
    "no zlib": b"\x89PNG\r\n\x1a\n" + chunk(b"IHDR", struct.pack(">II5B", 1, 1, 8, 2, 0, 0, 0)) + chunk(b"IEND", b""),
    "a wrong checksum": image(1, 2, GOOD).replace(b"x\0y", b"x\0z"),
    "a chunk that claims 2 GB": b"\x89PNG\r\n\x1a\n" + b"\x7f\xff\xff\xffIHDR" + bytes(100),
    "rows that take too long": image(1000, 1400, b"".join(b"\4" + bytes(3000) for _ in range(1400))),
}


@pytest.mark.parametrize("name", BAD)
def test_what_is_no_such_image_raises_decode_error(name: str) -> None:
    """A malformed image raises DecodeError."""
    with pytest.raises(DecodeError):
        unpack(BAD[name], limit_bytes=16 << 20)


def test_a_bomb_is_refused() -> None:
    """An image above the limit raises MessageTooBig before it is unpacked."""
    with pytest.raises(MessageTooBig):
        unpack(image(30_000, 30_000, GOOD), limit_bytes=LIMIT)


@settings(deadline=None)
@given(st.binary(max_size=100), st.integers(0, 120), st.integers(0, 255))
def test_only_documented_errors_are_raised(text: bytes, at: int, value: int) -> None:
    """A damaged image raises DecodeError or MessageTooBig, or is still one."""
    data = bytearray(pack(text))
    data[at % len(data)] = value
    with suppress(DecodeError, MessageTooBig):
        unpack(bytes(data), limit_bytes=LIMIT)
    with suppress(DecodeError, MessageTooBig):
        unpack(text, limit_bytes=LIMIT)
