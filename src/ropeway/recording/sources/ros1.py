"""Bags of ROS 1: by their index, or from front to back where the recorder was killed before it wrote one."""

from __future__ import annotations

import io
import struct
from collections import Counter
from collections.abc import Callable, Collection, Iterable, Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Any, BinaryIO, Final

from rosbags.rosbag1 import Reader
from rosbags.rosbag1.reader import decompressors

from ropeway.recording.offered_qos import recorded_qos
from ropeway.recording.sources.source import DAMAGED, RecordedChannel
from ropeway.recording.sources.unpacking import unpacked_bz2, unpacked_lz4

if TYPE_CHECKING:
    from typing_extensions import Self


__all__ = ["Ros1Scan", "Ros1Source"]

_LENGTH: Final = struct.Struct("<I")
_TIME: Final = struct.Struct("<II")
_MESSAGE, _CHUNK, _CONNECTION = b"\x02", b"\x05", b"\x07"
_UNPACK: Final[dict[bytes, Callable[[bytes], bytes]]] = {
    b"none": bytes,
    b"bz2": unpacked_bz2,
    b"lz4": unpacked_lz4,
}
_BOUNDED: Final = {decompressors[name.decode()]: unpack for name, unpack in _UNPACK.items()}
_RECORD_LIMIT_BYTES: Final = 1 << 30  # a length above is damage


class Ros1Source:
    """A bag with its index, in the order of time."""

    def __init__(self, path: Path) -> None:
        self._reader: Any = Reader(path)
        self.channels: list[RecordedChannel] = []
        self.start_ns = self.end_ns = 0
        self.notes: list[str] = []

    def __enter__(self) -> Self:
        self._reader.open()
        for place, chunk in self._reader.chunks.items():
            self._reader.chunks[place] = chunk._replace(decompressor=_BOUNDED[chunk.decompressor])
        self.start_ns, self.end_ns = self._reader.start_time, self._reader.end_time
        for number, connection in enumerate(self._reader.connections):
            self.channels.append(
                RecordedChannel(
                    id=number,
                    topic=connection.topic,
                    type=connection.msgtype,
                    definition=connection.msgdef.data,
                    encoding="ros1",
                    count=connection.msgcount,
                    qos=recorded_qos(connection.topic, [], latched=connection.ext.latching == 1),
                )
            )
        return self

    def __exit__(self, *_: object) -> None:
        self._reader.close()

    def messages(self, ids: Collection[int]) -> Iterator[tuple[int, int, bytes]]:
        """Yield the messages of these connections."""
        chosen = [connection for number, connection in enumerate(self._reader.connections) if number in ids]
        numbers = {id(connection): number for number, connection in enumerate(self._reader.connections)}
        for connection, time_ns, raw in self._reader.messages(connections=chosen):
            yield numbers[id(connection)], time_ns, bytes(raw)


class Ros1Scan:
    """A bag without an index or with a damaged one: all that is whole, in the order of the file."""

    def __init__(self, path: Path) -> None:
        self._file = path.open("rb")
        self.channels: list[RecordedChannel] = []
        self.start_ns = self.end_ns = 0
        self.notes: list[str] = ["it has no index, as it was cut short or is damaged; what is whole is played"]

    def __enter__(self) -> Self:
        try:
            connections: dict[int, tuple[dict[str, bytes], dict[str, bytes]]] = {}
            counts: Counter[int] = Counter()
            for header, data in self._records():
                number = _LENGTH.unpack(header["conn"])[0]
                if header["op"] == _CONNECTION:
                    connections.setdefault(number, (header, _fields(data)))
                else:
                    time_ns = _time_ns(header)
                    self.start_ns = min(self.start_ns, time_ns) if counts else time_ns
                    self.end_ns = max(self.end_ns, time_ns)
                    counts[number] += 1
            if not connections:
                raise ValueError("the bag is cut short or damaged, and nothing in it is whole")
            self.channels = [
                RecordedChannel(
                    id=number,
                    topic=about.get("topic", header.get("topic", b"")).decode(errors="replace"),
                    type=about.get("type", b"").decode(errors="replace"),
                    definition=about.get("message_definition", b"").decode(errors="replace"),
                    encoding="ros1",
                    count=counts[number],
                    qos=recorded_qos(
                        header.get("topic", b"").decode(errors="replace"), [], latched=about.get("latching") == b"1"
                    ),
                )
                for number, (header, about) in connections.items()
            ]
        except BaseException:
            self._file.close()
            raise
        return self

    def __exit__(self, *_: object) -> None:
        self._file.close()

    def messages(self, ids: Collection[int]) -> Iterator[tuple[int, int, bytes]]:
        """Yield the messages of these connections."""
        wanted = frozenset(ids)
        for header, data in self._records():
            if header["op"] == _MESSAGE and (number := _LENGTH.unpack(header["conn"])[0]) in wanted:
                yield number, _time_ns(header), data

    def _records(self) -> Iterator[tuple[dict[str, bytes], bytes]]:
        """Yield connections and messages, up to where the file ends or makes no sense any more."""
        self._file.seek(0)
        self._file.readline()
        try:
            for header, data in _read(self._file):
                if header["op"] == _CHUNK:
                    yield from _wanted(_read(io.BytesIO(_UNPACK[header["compression"]](data))))
                else:
                    yield from _wanted(((header, data),))
        except DAMAGED:
            return


def _wanted(records: Iterable[tuple[dict[str, bytes], bytes]]) -> Iterator[tuple[dict[str, bytes], bytes]]:
    for header, data in records:
        if header["op"] == _MESSAGE:
            _TIME.unpack(header["time"])
        if header["op"] in (_CONNECTION, _MESSAGE):
            _LENGTH.unpack(header["conn"])
            yield header, data


def _read(file: BinaryIO) -> Iterator[tuple[dict[str, bytes], bytes]]:
    while head := file.read(4):
        header = _fields(_exactly(file, _LENGTH.unpack(head)[0]))
        yield header, _exactly(file, _LENGTH.unpack(_exactly(file, 4))[0])


def _exactly(file: BinaryIO, length: int) -> bytes:
    if length > _RECORD_LIMIT_BYTES:
        raise ValueError("a record is beyond all size")
    found = file.read(length)
    if len(found) != length:
        raise EOFError
    return found


def _fields(raw: bytes) -> dict[str, bytes]:
    found: dict[str, bytes] = {}
    position = 0
    while position < len(raw):
        (length,) = _LENGTH.unpack_from(raw, position)
        name, _, value = raw[position + 4 : position + 4 + length].partition(b"=")
        found[name.decode()] = value
        position += 4 + length
    return found


def _time_ns(header: dict[str, bytes]) -> int:
    sec, nanosec = _TIME.unpack(header["time"])
    return int(sec) * 1_000_000_000 + int(nanosec)
