"""Opens chunks of MCAP files, which may come from anybody: none may take more memory than a recording needs."""

from __future__ import annotations

import struct
import zlib
from collections.abc import Iterator
from io import BytesIO
from typing import Final

import lz4.frame
import zstandard
from mcap.data_stream import ReadDataStream
from mcap.opcode import Opcode
from mcap.records import Channel, Chunk, McapRecord, Message, Schema

from ropeway.recording.sources.unpacking import CHUNK_BYTES

__all__ = ["CHUNK_MESSAGES", "chunk_records"]

CHUNK_MESSAGES: Final = 1 << 20
"""Messages of a chunk, each of which takes memory beside its bytes."""

_HEAD: Final = struct.Struct("<BQ")
_MESSAGE: Final = struct.Struct("<HIQQ")


def chunk_records(chunk: Chunk) -> Iterator[McapRecord]:
    """Yield the records of a chunk. Raises ``ValueError`` for one that is not what it says of itself."""
    data = _content(chunk)
    at, messages = 0, 0
    while at < len(data):
        opcode, length = _HEAD.unpack_from(data, at)
        begin = at + _HEAD.size
        at = begin + length
        if at > len(data):
            raise ValueError("a record is longer than its chunk")
        if opcode == Opcode.MESSAGE:
            messages += 1
            if messages > CHUNK_MESSAGES:
                raise ValueError(f"a chunk has more than {CHUNK_MESSAGES} messages")
            channel, sequence, log_time, publish_time = _MESSAGE.unpack_from(data, begin)
            yield Message(
                channel_id=channel,
                sequence=sequence,
                log_time=log_time,
                publish_time=publish_time,
                data=data[begin + _MESSAGE.size : at],
            )
        elif opcode == Opcode.CHANNEL:
            yield Channel.read(_stream(data[begin:at]))
        elif opcode == Opcode.SCHEMA:
            yield Schema.read(_stream(data[begin:at]))


def _content(chunk: Chunk) -> bytes:
    """Return the records of a chunk as bytes, checked."""
    size = chunk.uncompressed_size
    if size > CHUNK_BYTES:
        raise ValueError(f"a chunk says that it has {size} bytes; {CHUNK_BYTES} are read at most")
    if chunk.compression == "zstd":
        with zstandard.ZstdDecompressor().stream_reader(chunk.data) as reader:
            data = reader.read(size + 1)
    elif chunk.compression == "lz4":
        data = lz4.frame.LZ4FrameDecompressor().decompress(chunk.data, max_length=size + 1)
    elif chunk.compression:
        raise ValueError(f"a chunk is compressed by {chunk.compression[:20]!r}, which is not known")
    else:
        data = chunk.data
    if len(data) != size:
        raise ValueError("a chunk has not as many bytes as it says")
    if chunk.uncompressed_crc and zlib.crc32(data) != chunk.uncompressed_crc:
        raise ValueError("the checksum of a chunk is wrong")
    return data


def _stream(data: bytes) -> ReadDataStream:
    return ReadDataStream(BytesIO(data))
