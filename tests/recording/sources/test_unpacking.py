"""What recorders have compressed, and what only looks like it."""

from __future__ import annotations

import bz2
import shutil
import tempfile
from collections.abc import Callable
from pathlib import Path
from typing import Any, NamedTuple

import lz4.frame
import pytest
import zstandard
from rosbags.rosbag1 import Writer
from rosbags.rosbag2 import StoragePlugin

from ropeway.errors import BagUnreadable
from ropeway.recording.bag import Bag
from ropeway.recording.sources import folder, ros1, unpacking
from ropeway.recording.sources.source import DAMAGED
from ropeway.recording.sources.unpacking import Unpacker, unpacked_bz2, unpacked_lz4
from ropeway.types import TypeRegistry
from tests.recording.test_bag import write_rosbag2

_MIB = 1 << 20


def packed_file(directory: Path, size: int) -> Path:
    """Return a file of a few bytes for each MiB that it unpacks to."""
    file = directory / "a.db3.zstd"
    with file.open("wb") as out, zstandard.ZstdCompressor().stream_writer(out) as packing:
        for at in range(0, size, _MIB):
            packing.write(bytes(min(_MIB, size - at)))
    return file


def test_a_file_is_unpacked(tmp_path: Path) -> None:
    """A file of as many bytes as may be is unpacked whole, and counts for all files of its recording."""
    unpacker = Unpacker(most_bytes=5 * _MIB)
    unpacker.file(packed_file(tmp_path, 3 * _MIB), tmp_path / "a.db3")
    assert (tmp_path / "a.db3").read_bytes() == bytes(3 * _MIB)
    assert unpacker.left_bytes == 2 * _MIB


def test_a_file_that_grows_too_much_is_refused(tmp_path: Path) -> None:
    """Files that unpack to more than a recording may have are refused with what to do, and leave nothing behind."""
    unpacker, packed = Unpacker(most_bytes=5 * _MIB), packed_file(tmp_path, 3 * _MIB)
    unpacker.file(packed, tmp_path / "a.db3")
    with pytest.raises(ValueError, match=r"a\.db3\.zstd is refused.*zstd -d"):
        unpacker.file(packed, tmp_path / "b.db3")
    assert not (tmp_path / "b.db3").exists()


def test_a_disk_is_not_filled(tmp_path: Path) -> None:
    """A file is refused, and what was unpacked of it removed, before the disk has less free than others need."""
    free = shutil.disk_usage(tmp_path).free
    with pytest.raises(ValueError, match=r"would leave less than .* free in .*TMPDIR"):
        Unpacker(reserve_bytes=free).file(packed_file(tmp_path, _MIB), tmp_path / "a.db3")
    assert not (tmp_path / "a.db3").exists()


class _Usage(NamedTuple):
    free: int


def test_a_disk_is_looked_at_again_and_again(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """What others write meanwhile counts: the disk is looked at while a large file is unpacked."""
    left = iter((1 << 40, 0))
    monkeypatch.setattr(shutil, "disk_usage", lambda _: _Usage(next(left)))
    with pytest.raises(ValueError, match="would leave less than 1 GiB free"):
        Unpacker().file(packed_file(tmp_path, 200 * _MIB), tmp_path / "a.db3")
    assert not (tmp_path / "a.db3").exists()


def test_a_damaged_file_leaves_nothing(tmp_path: Path) -> None:
    """A file that is no frame of Zstandard is an error of the recording, and leaves nothing behind."""
    packed = tmp_path / "a.db3.zstd"
    packed.write_bytes(b"\x28\xb5\x2f\xfdnonsense")
    with pytest.raises(zstandard.ZstdError):
        Unpacker().file(packed, tmp_path / "a.db3")
    assert not (tmp_path / "a.db3").exists()


@pytest.mark.parametrize(
    ("pack", "unpack"),
    [
        (zstandard.compress, Unpacker().message),
        (bz2.compress, unpacked_bz2),
        (lz4.frame.compress, unpacked_lz4),
    ],
    ids=["zstd", "bz2", "lz4"],
)
def test_chunks_and_messages(
    monkeypatch: pytest.MonkeyPatch, pack: Callable[[bytes], bytes], unpack: Callable[[bytes], bytes]
) -> None:
    """A chunk or a message is unpacked up to its limit, and refused beyond it and where it is cut short."""
    monkeypatch.setattr(unpacking, "CHUNK_BYTES", _MIB)
    assert unpack(pack(bytes(_MIB))) == bytes(_MIB)
    with pytest.raises(ValueError, match="is refused: unpacked, it has more than 1 MiB"):
        unpack(pack(bytes(_MIB + 1)))
    with pytest.raises(DAMAGED):
        unpack(pack(bytes(range(256)))[:-9])


def bomb(directory: Path, compression: Any) -> Path:
    """Return a bag of ROS 1 with one chunk that unpacks to two MiB."""
    file = directory / "a.bag"
    writer = Writer(file)
    writer.set_compression(compression)
    with writer:
        connection = writer.add_connection("/a", "std_msgs/msg/String", msgdef="string data", md5sum="0" * 32)
        writer.write(connection, 1, (2 * _MIB).to_bytes(4, "little") + bytes(2 * _MIB))
    return file


@pytest.mark.parametrize("compression", [Writer.CompressionFormat.BZ2, Writer.CompressionFormat.LZ4])
@pytest.mark.parametrize("cut", [False, True], ids=["index", "scan"])
def test_bags_of_ros_1(monkeypatch: pytest.MonkeyPatch, tmp_path: Path, compression: Any, cut: bool) -> None:
    """A chunk of a bag that grows too much ends the reading, with the index of the bag and without."""
    file = bomb(tmp_path, compression)
    open_it = ros1.Ros1Scan if cut else ros1.Ros1Source
    with open_it(file) as source:
        assert [len(raw) for _, _, raw in source.messages([0])] == [2 * _MIB + 4]
    monkeypatch.setattr(unpacking, "CHUNK_BYTES", _MIB)
    with pytest.raises(ValueError, match=r"more than 1 MiB|nothing in it is whole"), open_it(file) as source:
        list(source.messages([0]))


def test_a_directory_is_refused(tmp_path: Path, registry: TypeRegistry, monkeypatch: pytest.MonkeyPatch) -> None:
    """A recording whose files grow too much is not opened, and the directory for its files is gone."""
    bag = write_rosbag2(tmp_path / "bag", registry, StoragePlugin.SQLITE3)
    (bag / "metadata.yaml").unlink()
    packed_file(bag, 3 * _MIB)
    scratch = tmp_path / "scratch"
    scratch.mkdir()
    monkeypatch.setattr(tempfile, "tempdir", str(scratch))
    monkeypatch.setattr(folder, "Unpacker", lambda: Unpacker(most_bytes=_MIB))
    with pytest.raises(BagUnreadable, match="takes more than"), Bag(bag, registry):
        pass
    assert list(scratch.iterdir()) == []
