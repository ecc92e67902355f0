"""Writes one MCAP file in chunks. A payload goes to the operating system as it is, without a copy of its own.

A chunk ends when it is large or old enough (``end_chunk``), so that a process that is killed loses little. Where the
disk is full, what is there of the last chunk is taken back: every file ends behind a whole chunk, with an index if
there is room for one. All methods block. The layout is that of the specification: https://mcap.dev/spec.
"""

from __future__ import annotations

import os
import struct
import zlib
from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from io import FileIO
from typing import Final, NamedTuple

from ropeway.extras import needing

__all__ = ["COMPRESSIONS", "LostMessages", "McapWriter"]

MAGIC: Final = b"\x89MCAP0\r\n"
COMPRESSIONS: Final = ("none", "lz4", "zstd")
CHUNK_BYTES: Final = 1 << 20
"""A chunk with so much is written: a crash loses no more, and a reader decompresses no more at once."""

_HEADER, _FOOTER, _SCHEMA, _CHANNEL, _MESSAGE, _CHUNK, _MESSAGE_INDEX, _CHUNK_INDEX = range(1, 9)
_STATISTICS, _SUMMARY_OFFSET, _DATA_END = 0x0B, 0x0E, 0x0F

_RECORD: Final = struct.Struct("<BQ")
_MESSAGE_HEAD: Final = struct.Struct("<BQHIQQ")
_MESSAGE_FIELDS_BYTES: Final = _MESSAGE_HEAD.size - _RECORD.size
_INDEX_ENTRY: Final = struct.Struct("<QQ")
_CHUNK_HEAD: Final = struct.Struct("<QQQI")
_APART_BYTES: Final = 8 << 10  # a larger payload is not copied beside its neighbours, but written by itself
_PARTS: Final = 512  # that one call of the operating system takes; Linux takes 1024
_ZSTD_LEVEL: Final = 1  # of a raw image three times as fast as the default, for a tenth more bytes


def _text(value: str) -> bytes:
    raw = value.encode()
    return struct.pack("<I", len(raw)) + raw


def _map(pairs: bytes) -> bytes:
    return struct.pack("<I", len(pairs)) + pairs


def _record(opcode: int, body: bytes) -> bytes:
    return _RECORD.pack(opcode, len(body)) + body


class LostMessages(NamedTuple):
    """Counts messages that are not in the file, and the bytes of their payloads."""

    messages: int
    payload_bytes: int


class _ChunkInProgress:
    """The records of the chunk that comes next, and where the messages of each channel stand in it."""

    def __init__(self) -> None:
        self.parts: list[bytes | bytearray] = []
        self.tail = bytearray()
        self.size = self.messages = self.payload_bytes = 0
        self.first_ns = self.last_ns = 0
        self.index: dict[int, bytearray] = {}

    def add_record(self, record: bytes) -> None:
        """Add a schema or a channel."""
        self.tail += record
        self.size += len(record)

    def add_message(self, channel: int, time_ns: int, sequence: int, payload: bytes) -> None:
        """Add a message."""
        size = len(payload)
        entries = self.index.get(channel)
        if entries is None:
            entries = self.index[channel] = bytearray()
        entries += _INDEX_ENTRY.pack(time_ns, self.size)
        tail = self.tail
        tail += _MESSAGE_HEAD.pack(
            _MESSAGE, _MESSAGE_FIELDS_BYTES + size, channel, sequence & 0xFFFFFFFF, time_ns, time_ns
        )
        if size < _APART_BYTES:
            tail += payload
        else:
            self.parts += (tail, payload)
            self.tail = bytearray()
        if not self.messages:
            self.first_ns = self.last_ns = time_ns
        elif time_ns > self.last_ns:
            self.last_ns = time_ns
        elif time_ns < self.first_ns:
            self.first_ns = time_ns
        self.messages += 1
        self.payload_bytes += size
        self.size += _MESSAGE_HEAD.size + size

    def content(self) -> list[bytes | bytearray]:
        """Return the records, in parts."""
        return [*self.parts, self.tail] if self.tail else self.parts


class McapWriter:
    """Writes to ``file``, which is new and unbuffered. ``OSError`` is raised as it is; call ``rescue`` then."""

    def __init__(self, file: FileIO, *, compression: str = "none", profile: str = "ros2", library: str = "") -> None:
        self._file = file
        self._compression = "" if compression == "none" else compression
        self._compress: Callable[[bytes], bytes] | None = _compressor(compression)
        self._offset = 0  # behind the last whole record
        self._schemas: dict[tuple[str, str, str], tuple[int, bytes]] = {}
        self._channels: list[bytes] = []
        self._counts: Counter[int] = Counter()
        self._chunk_index, self._chunks = bytearray(), 0
        self._first_ns = self._last_ns = 0
        self._next = _ChunkInProgress()
        self._write([MAGIC, _record(_HEADER, _text(profile) + _text(library))])

    @property
    def size(self) -> int:
        """The size of the file, once what waits in the chunk is written."""
        return self._offset + self._next.size

    @property
    def pending(self) -> bool:
        """Whether messages wait for the end of their chunk."""
        return self._next.messages > 0

    def add_channel(self, topic: str, encoding: str, schema: tuple[str, str, str], metadata: Mapping[str, str]) -> int:
        """Add a channel whose ``schema`` is a name, an encoding and a text; return its number."""
        known = self._schemas.get(schema)
        if known is None:
            name, schema_encoding, text = schema
            number = len(self._schemas) + 1
            body = struct.pack("<H", number) + _text(name) + _text(schema_encoding) + _text(text)
            known = self._schemas[schema] = number, _record(_SCHEMA, body)
            self._next.add_record(known[1])
        number = len(self._channels) + 1
        pairs = b"".join(_text(key) + _text(value) for key, value in metadata.items())
        body = struct.pack("<HH", number, known[0]) + _text(topic) + _text(encoding) + _map(pairs)
        self._channels.append(_record(_CHANNEL, body))
        self._next.add_record(self._channels[-1])
        return number

    def add_message(self, channel: int, time_ns: int, sequence: int, payload: bytes) -> None:
        """Add a message."""
        chunk = self._next
        chunk.add_message(channel, time_ns, sequence, payload)
        if chunk.size >= CHUNK_BYTES:
            self.end_chunk()

    def end_chunk(self) -> None:
        """Write what waits as a chunk."""
        chunk = self._next
        if not chunk.messages:
            return
        content = chunk.content()
        crc = 0
        for part in content:
            crc = zlib.crc32(part, crc)
        if self._compress is not None:
            content = [self._compress(b"".join(content))]
        size = sum(map(len, content))
        fields = _CHUNK_HEAD.pack(chunk.first_ns, chunk.last_ns, chunk.size, crc) + _text(self._compression)
        head = _RECORD.pack(_CHUNK, len(fields) + 8 + size) + fields + struct.pack("<Q", size)
        start, length = self._offset, len(head) + size
        index, offsets = bytearray(), bytearray()
        for channel, entries in chunk.index.items():
            offsets += struct.pack("<HQ", channel, start + length + len(index))
            index += _record(_MESSAGE_INDEX, struct.pack("<HI", channel, len(entries)) + entries)
        self._write([head, *content, index])
        self._next = _ChunkInProgress()
        about = struct.pack("<QQQQ", chunk.first_ns, chunk.last_ns, start, length) + _map(bytes(offsets))
        about += struct.pack("<Q", len(index)) + _text(self._compression) + struct.pack("<QQ", size, chunk.size)
        self._chunk_index += _record(_CHUNK_INDEX, about)
        self._first_ns = min(self._first_ns, chunk.first_ns) if self._chunks else chunk.first_ns
        self._last_ns = max(self._last_ns, chunk.last_ns)
        self._chunks += 1
        for channel, entries in chunk.index.items():
            self._counts[channel] += len(entries) // _INDEX_ENTRY.size

    def finish(self) -> None:
        """Write what waits and the index, and close the file."""
        self.end_chunk()
        self._write_summary()
        self._file.close()

    def rescue(self) -> LostMessages:
        """Close a file that could not be written: behind the last whole chunk, with an index if there is room.

        Return the messages of the chunk that was to come, which are lost.
        """
        lost = LostMessages(self._next.messages, self._next.payload_bytes)
        try:
            self._file.truncate(self._offset)
            self._file.seek(self._offset)
            self._write_summary()
        except OSError:
            pass
        finally:
            _close(self._file)
        return lost

    def _write_summary(self) -> None:
        start = self._offset + len(_record(_DATA_END, bytes(4)))
        summary, offsets = bytearray(), bytearray()
        groups: Sequence[tuple[int, bytes]] = (
            (_SCHEMA, b"".join(record for _, record in self._schemas.values())),
            (_CHANNEL, b"".join(self._channels)),
            (_STATISTICS, self._statistics()),
            (_CHUNK_INDEX, bytes(self._chunk_index)),
        )
        for opcode, records in groups:
            if records:
                place = struct.pack("<BQQ", opcode, start + len(summary), len(records))
                offsets += _record(_SUMMARY_OFFSET, place)
                summary += records
        offsets_start = start + len(summary)
        summary += offsets
        footer = _RECORD.pack(_FOOTER, 20) + struct.pack("<QQ", start, offsets_start)
        crc = zlib.crc32(footer, zlib.crc32(summary))
        self._write([_record(_DATA_END, bytes(4)), summary, footer + struct.pack("<I", crc), MAGIC])

    def _statistics(self) -> bytes:
        counts = b"".join(struct.pack("<HQ", channel, count) for channel, count in sorted(self._counts.items()))
        numbers = (sum(self._counts.values()), len(self._schemas), len(self._channels), 0, 0, self._chunks)
        times = self._first_ns, self._last_ns
        return _record(_STATISTICS, struct.pack("<QHIIIIQQ", *numbers, *times) + _map(counts))

    def _write(self, parts: Sequence[bytes | bytearray]) -> None:
        for first in range(0, len(parts), _PARTS):
            _write_all(self._file, parts[first : first + _PARTS])
        self._offset += sum(map(len, parts))


def _compressor(compression: str) -> Callable[[bytes], bytes] | None:
    """Return what compresses a chunk, ``None`` for nothing. Only who compresses needs the libraries."""
    with needing(f"{compression} in a recording"):
        if compression == "zstd":
            import zstandard

            return zstandard.ZstdCompressor(level=_ZSTD_LEVEL).compress
        if compression == "lz4":
            import lz4.frame

            return lz4.frame.compress  # type: ignore[no-any-return]
    return None


def _write_all(file: FileIO, parts: Sequence[bytes | bytearray]) -> None:
    """Write parts one after the other, in one call where the system can."""
    size = sum(map(len, parts))
    written = os.writev(file.fileno(), parts) if hasattr(os, "writev") else 0
    if written < size:
        rest = memoryview(b"".join(parts))[written:]
        while rest:
            rest = rest[file.write(rest) or 0 :]


def _close(file: FileIO) -> None:
    try:
        file.close()
    except OSError:
        return
