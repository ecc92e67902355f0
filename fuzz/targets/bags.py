"""Recordings, damaged in any way: a file or a directory is opened and all of it is read."""

from __future__ import annotations

import io
import struct
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Final

from mcap.writer import CompressionType
from mcap.writer import Writer as McapWriter
from rosbags.rosbag1 import Writer as Rosbag1Writer
from rosbags.rosbag2 import StoragePlugin
from rosbags.rosbag2 import Writer as Rosbag2Writer

from fuzz.target import Target
from ropeway.errors import BagUnreadable
from ropeway.recording.bag import Bag
from ropeway.types import TypeRegistry

__all__ = ["TARGETS"]

_STRING: Final = "std_msgs/msg/String"
_QOS: Final = "- history: 1\n  depth: 3\n  reliability: 2\n  durability: 1\n"
_CDR: Final = b"\0\1\0\0\2\0\0\0a\0"
_RECORDS: Final = 1000
_SLOW_S: Final = 3.0  # a bag is the user's own file
_MAGIC: Final = b"\x89MCAP0\r\n"


def _play(path: Path) -> None:
    with Bag(path, TypeRegistry()) as bag:
        assert bag.duration_s >= 0
        for number, _ in enumerate(bag.records()):
            if number > _RECORDS:
                return


def _file(data: bytes) -> None:
    with TemporaryDirectory(prefix="fuzz-") as folder:
        path = Path(folder) / "bag"
        path.write_bytes(data)
        _play(path)


def _records(data: bytes) -> None:
    """Records of MCAP between a mark, each an opcode and a content whose length is put right, then the file's end."""
    parts = [part for part in data.split(b"record") if part]
    body = b"".join(part[:1] + struct.pack("<Q", len(part) - 1) + part[1:] for part in parts)
    _file(_MAGIC + body + _MAGIC)


def _metadata(data: bytes) -> None:
    """``metadata.yaml`` beside a storage file that is whole."""
    with TemporaryDirectory(prefix="fuzz-") as folder:
        path = Path(folder)
        (path / "bag_0.mcap").write_bytes(_mcap(CompressionType.NONE))
        (path / "metadata.yaml").write_bytes(data)
        _play(path)


def _mcap(compression: CompressionType) -> bytes:
    out = io.BytesIO()
    writer = McapWriter(out, compression=compression)
    writer.start("ros2")
    schema = writer.register_schema(_STRING, "ros2msg", b"string data\n")
    channel = writer.register_channel("/a", "cdr", schema, {"offered_qos_profiles": _QOS})
    for time in (1, 2):
        writer.add_message(channel, log_time=time, data=_CDR, publish_time=time)
    writer.finish()
    return out.getvalue()


def _mcaps() -> list[bytes]:
    return [_mcap(kind) for kind in (CompressionType.NONE, CompressionType.ZSTD, CompressionType.LZ4)]


def _split(file: bytes) -> bytes:
    """The records of a file as ``_records`` takes them."""
    at, parts = len(_MAGIC), []
    while at < len(file) - len(_MAGIC):
        (length,) = struct.unpack_from("<Q", file, at + 1)
        parts.append(file[at : at + 1] + file[at + 9 : at + 9 + length])
        at += 9 + length
    return b"record".join(parts)


def _rosbag1() -> list[bytes]:
    made = []
    for compression in (None, Rosbag1Writer.CompressionFormat.BZ2):
        with TemporaryDirectory(prefix="fuzz-") as folder:
            path = Path(folder) / "a.bag"
            writer = Rosbag1Writer(path)
            if compression is not None:
                writer.set_compression(compression)
            with writer:
                connection = writer.add_connection(
                    "/a", _STRING, msgdef="string data\n", md5sum="992ce8a1687cec8c8bd883ec73ca41d1"
                )
                writer.write(connection, 1, b"\1\0\0\0a")
            made.append(path.read_bytes())
    return made


def _rosbag2() -> list[bytes]:
    with TemporaryDirectory(prefix="fuzz-") as folder:
        path = Path(folder) / "bag"
        with Rosbag2Writer(path, version=8, storage_plugin=StoragePlugin.MCAP) as writer:
            connection = writer.add_connection("/a", _STRING, msgdef="string data\n", rihs01="RIHS01_" + "0" * 64)
            writer.write(connection, 1, _CDR)
        text = (path / "metadata.yaml").read_bytes()
    return [text.replace(b"bag.mcap", b"bag_0.mcap")]


TARGETS: Final = {
    "mcap": Target(_file, (BagUnreadable,), _mcaps, (_MAGIC,), cpu_s=_SLOW_S),
    "mcap-records": Target(_records, (BagUnreadable,), lambda: map(_split, _mcaps()), (b"record",), cpu_s=_SLOW_S),
    "rosbag1": Target(
        _file,
        (BagUnreadable,),
        _rosbag1,
        (b"#ROSBAG V2.0\n", b"op=", b"conn=", b"chunk_count=", b"index_pos="),
        longest_bytes=8192,
        cpu_s=_SLOW_S,
    ),
    "rosbag2": Target(
        _metadata,
        (BagUnreadable,),
        _rosbag2,
        (b"null", b"[]", b"!!", b"&a", b"*a", b"version: ", b"relative_file_paths:"),
        cpu_s=_SLOW_S,
    ),
}
