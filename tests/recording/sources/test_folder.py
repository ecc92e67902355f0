"""Directories of rosbag2 whose metadata and files agree or do not."""

from __future__ import annotations

import sqlite3
from pathlib import Path
from typing import Any

import pytest
import yaml
import zstandard
from rosbags.rosbag2 import StoragePlugin

from ropeway.errors import BagUnreadable
from ropeway.recording.bag import Bag
from ropeway.types import TypeRegistry
from tests.recording.test_bag import messages, write_mcap, write_one, write_rosbag2


def read(path: Path) -> tuple[int, list[str], list[str]]:
    """How many messages a recording has, what is told of it, and what is told of its topics."""
    with Bag(path, TypeRegistry()) as bag:
        return len(list(bag.records())), list(bag.notes), [t.problem for t in bag.topics if t.problem]


def change(path: Path, **values: Any) -> None:
    """Change the metadata."""
    file = path / "metadata.yaml"
    found = yaml.safe_load(file.read_text())
    about = found["rosbag2_bagfile_information"]
    about.update({key: value for key, value in values.items() if value is not None})
    for key in [key for key, value in values.items() if value is None]:
        del about[key]
    file.write_text(yaml.safe_dump(found))


@pytest.fixture(params=[StoragePlugin.SQLITE3, StoragePlugin.MCAP], ids=["sqlite3", "mcap"])
def folder(request: pytest.FixtureRequest, tmp_path: Path, registry: TypeRegistry) -> Path:
    """A recording of four messages."""
    return write_rosbag2(tmp_path / "bag", registry, request.param)


@pytest.mark.parametrize(
    "topics",
    [
        [],
        None,
        [{"topic_metadata": {"name": "/other", "type": "a/msg/B", "serialization_format": "x"}, "message_count": 9}],
        [{"topic_metadata": {"name": "/text", "type": "std_msgs/msg/Bool", "offered_qos_profiles": "- {depth: 7}"}}],
    ],
)
def test_topics_of_the_metadata_do_not_matter(folder: Path, topics: Any) -> None:
    """What the files say of their topics counts, whatever metadata.yaml says."""
    change(folder, topics_with_message_count=topics)
    assert read(folder) == (4, [], [])


def test_missing_metadata(folder: Path) -> None:
    """Without metadata, or with one that is something else or cut short, all files are played, and that is told."""
    for text in ("a: 1\n", "", "a: [1, 2", "a: 'b", "!!python/object/apply:os.system ['true']", "\t", "\x00"):
        (folder / "metadata.yaml").write_text(text)
        assert read(folder)[:2] == (4, ["metadata.yaml is not from rosbag2; all files next to it are played"])
    (folder / "metadata.yaml").unlink()
    assert read(folder)[:2] == (4, ["it has no metadata.yaml; all files in it are played"])


def test_files_that_the_metadata_does_not_name(folder: Path, registry: TypeRegistry) -> None:
    """A file that is not named, one that is not there, and another count of messages are told."""
    (name,) = (file.name for file in folder.iterdir() if file.suffix in (".db3", ".mcap"))
    write_mcap(folder / "more.mcap", registry)
    change(folder, relative_file_paths=[f"somewhere/{name}", "gone.mcap"], message_count=5)
    count, notes, _ = read(folder)
    assert count == 4
    assert notes == [
        "metadata.yaml names gone.mcap, which is not there",
        "more.mcap is not named in metadata.yaml and not played",
        "metadata.yaml tells of 5 messages, the files have 4",
    ]
    change(folder, relative_file_paths=["gone.mcap"], message_count=8)
    assert read(folder)[0] == 8


def test_several_files_are_one_recording(tmp_path: Path, registry: TypeRegistry) -> None:
    """Messages of several files, of both kinds of storage, come in the order of time."""
    folder = write_rosbag2(tmp_path / "bag", registry, StoragePlugin.SQLITE3)
    write_mcap(folder / "more.mcap", registry)
    (folder / "metadata.yaml").unlink()
    with Bag(folder, TypeRegistry()) as bag:
        times = [record.time_ns for record in bag.records()]
    assert times == sorted(times)
    assert len(times) == 2 * len(messages(registry))


def test_channels_of_other_formats_cost_no_other(tmp_path: Path, registry: TypeRegistry) -> None:
    """JSON and Protobuf beside ROS messages are told and left out, in a directory as in a file."""
    folder = tmp_path / "bag"
    folder.mkdir()
    write_mcap(folder / "a.mcap", registry)
    write_one(folder / "b.mcap", "/json", "note", "json", "jsonschema", "{}", b"{}")
    write_one(folder / "c.mcap", "/proto", "pkg.Note", "protobuf", "protobuf", "\x80", b"\x08\x01")
    count, _, problems = read(folder)
    assert count == 4
    assert sorted(problems) == [f"its messages are {name}, not CDR or ROS 1" for name in ("json", "protobuf")]


def test_compressed_files(folder: Path) -> None:
    """Files that rosbag2 compressed are unpacked."""
    (file,) = (file for file in folder.iterdir() if file.suffix in (".db3", ".mcap"))
    packed = file.with_name(f"{file.name}.zstd")
    packed.write_bytes(zstandard.compress(file.read_bytes()))
    file.unlink()
    change(folder, compression_mode="FILE", compression_format="zstd", relative_file_paths=[packed.name])
    assert read(folder) == (4, [], [])


def test_compressed_messages(tmp_path: Path, registry: TypeRegistry) -> None:
    """Messages that rosbag2 compressed are unpacked."""
    folder = write_rosbag2(tmp_path / "bag", registry, StoragePlugin.SQLITE3)
    (file,) = folder.glob("*.db3")
    with sqlite3.connect(file) as db:
        for id, data in db.execute("SELECT id, data FROM messages").fetchall():
            db.execute("UPDATE messages SET data = ? WHERE id = ?", (zstandard.compress(data), id))
    db.close()
    change(folder, compression_mode="MESSAGE", compression_format="zstd")
    with Bag(folder, TypeRegistry()) as bag:
        for record in bag.records():
            bag.registry.codec(record.topic.type).decode(record.payload)


@pytest.mark.parametrize(
    ("begin", "text"),
    [
        (b"", "is empty"),
        (b"/annex/objects/SHA256E-s5--00.bag\n", "pointer of git-annex.*git annex get"),
        (b"\x1f\x8b\x08\x00", "packed with gzip; unpack it first"),
        (b"PK\x03\x04", "packed with ZIP"),
        (b"(\xb5/\xfd", "packed with zstd"),
        (b"#ROSRECORD V1.1\n", "before version 2.0"),
        (b"<!DOCTYPE html>", "not a recording of a known kind"),
    ],
)
def test_what_is_no_recording(tmp_path: Path, begin: bytes, text: str) -> None:
    """A file that is no recording is named as what it is, with what makes a recording of it."""
    (tmp_path / "a.bag").write_bytes(begin + bytes(20) if begin else b"")
    with pytest.raises(BagUnreadable, match=text):
        read(tmp_path / "a.bag")


def test_links_that_lead_nowhere(tmp_path: Path) -> None:
    """A link to a file that is not there is told as one, and as one of git-annex where it is that."""
    for target, text in (("gone.bag", "leads to gone.bag, which is not there"), ("x/annex/objects/y", "git annex get")):
        (tmp_path / "a.bag").unlink(missing_ok=True)
        (tmp_path / "a.bag").symlink_to(target)
        with pytest.raises(BagUnreadable, match=text):
            read(tmp_path / "a.bag")


def test_pointers_of_git_lfs(folder: Path) -> None:
    """A pointer of Git LFS in the place of a file is named as one, wherever it stands."""
    pointer = "version https://git-lfs.github.com/spec/v1\noid sha256:00\nsize 12\n"
    for file in sorted(folder.iterdir()):
        file.write_text(pointer)
        for path in (folder, file):
            if path.name != "metadata.yaml":
                with pytest.raises(BagUnreadable, match=r"pointer of Git LFS.*git lfs pull"):
                    read(path)
