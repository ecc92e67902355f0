"""ropeway.recording.sources.mcap_chunks: chunks that come from anybody."""

from __future__ import annotations

import struct
import zlib
from pathlib import Path

import lz4.frame
import pytest
import zstandard
from mcap.records import Chunk, Message

from ropeway.recording.bag import Bag
from ropeway.recording.mcap_writer import COMPRESSIONS
from ropeway.recording.sources import mcap_chunks
from ropeway.recording.sources.mcap_chunks import chunk_records
from ropeway.types import TypeRegistry
from tests.recording.test_mcap_writer import SCHEMA, new
from tests.support.messages import text


def message(payload: bytes = b"x") -> bytes:
    return struct.pack("<BQHIQQ", 5, 22 + len(payload), 1, 0, 7, 7) + payload


def chunk(data: bytes, compression: str = "", *, size: int | None = None, crc: int | None = None) -> Chunk:
    return Chunk(
        compression=compression,
        data=data,
        message_start_time=0,
        message_end_time=0,
        uncompressed_crc=0 if crc is None else crc,
        uncompressed_size=len(data) if size is None else size,
    )


def test_messages() -> None:
    """Messages are read whatever the chunk is compressed with, and a checksum that is right is no matter."""
    plain = message(b"a") + message(b"b")
    packed = {"": plain, "zstd": zstandard.compress(plain), "lz4": lz4.frame.compress(plain)}
    for compression, data in packed.items():
        made = chunk(data, compression, size=len(plain), crc=zlib.crc32(plain))
        assert [one.data for one in chunk_records(made) if isinstance(one, Message)] == [b"a", b"b"]


@pytest.mark.parametrize(
    "made",
    [
        chunk(zstandard.compress(bytes(50 << 20)), "zstd", size=10),
        chunk(zstandard.ZstdCompressor(write_content_size=False).compress(bytes(50 << 20)), "zstd", size=10),
        chunk(lz4.frame.compress(bytes(50 << 20)), "lz4", size=10),
        chunk(b"", "zstd", size=2**62),
        chunk(message(), size=2**63),
        chunk(message(), "gzip"),
        chunk(message(), crc=1),
        chunk(message()[:-1]),
        chunk(struct.pack("<BQ", 5, 2**63)),
        chunk(b"\x05"),
    ],
    ids=[
        "zstd",
        "zstd without its size",
        "lz4",
        "a size",
        "a longer size",
        "unknown",
        "checksum",
        "cut",
        "long",
        "head",
    ],
)
def test_hostile(made: Chunk) -> None:
    """A chunk that is not what it says, or unpacks to more, is an error, and takes no more memory than it said."""
    with pytest.raises((ValueError, struct.error, zstandard.ZstdError)):
        list(chunk_records(made))


def test_many_messages(monkeypatch: pytest.MonkeyPatch) -> None:
    """A chunk has no more messages than memory is there for."""
    monkeypatch.setattr(mcap_chunks, "CHUNK_MESSAGES", 3)
    assert len(list(chunk_records(chunk(message() * 3)))) == 3
    with pytest.raises(ValueError, match="more than 3 messages"):
        list(chunk_records(chunk(message() * 4)))


@pytest.mark.parametrize("compression", COMPRESSIONS)
def test_a_flipped_bit(tmp_path: Path, compression: str) -> None:
    """Of a whole file with one damaged chunk everything else is played, and it is said how much is missing."""
    path = tmp_path / "a.mcap"
    writer = new(path, compression)
    channel = writer.add_channel("/a", "cdr", SCHEMA, {})
    places = []
    for number in range(3):
        places.append(path.stat().st_size)
        writer.add_message(channel, number, number, text(str(number)))
        writer.end_chunk()
    writer.finish()
    data = bytearray(path.read_bytes())
    head = 9 + 28 + 4 + (0 if compression == "none" else len(compression)) + 8  # of the record of a chunk
    data[places[1] + head + 12] ^= 0xFF
    path.write_bytes(data)
    with Bag(path, TypeRegistry()) as bag:
        assert [one.payload for one in bag.records()] == [text("0"), text("2")]
