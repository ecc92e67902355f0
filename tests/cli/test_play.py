"""``ropeway play``: what it says, and how it ends."""

from __future__ import annotations

from pathlib import Path

import pytest
from mcap.writer import Writer as McapWriter

from ropeway.qos import LATCHED, QoS
from ropeway.recording.channel import Recorded, cdr_channel
from ropeway.recording.files import McapFiles
from ropeway.types import TypeRegistry
from tests.cli.conftest import Ropeway
from tests.support.messages import STRING, text

SECOND = 10**9


def played_by_cli(ropeway: Ropeway, path: Path, *more: str) -> tuple[int, str]:
    """Status and words of ``ropeway play``."""
    done = ropeway("play", str(path), "--wait", "0", *more)
    return done.returncode, done.stderr


def test_a_recording_that_plays_nothing_fails(ropeway: Ropeway, tmp_path: Path) -> None:
    """A recording with messages none of which can be played fails and says why; one without messages does not."""
    path = tmp_path / "a.mcap"
    with path.open("wb") as file:
        writer = McapWriter(file)
        writer.start("ros1")
        schema = writer.register_schema("std_msgs/String", "ros1msg", b"string data\n")
        channel = writer.register_channel("/text", "ros1", schema)
        writer.add_message(channel, 1, b"\xff", 1)
        writer.finish()
    status, words = played_by_cli(ropeway, path)
    assert status == 1
    assert "none of the 1 messages" in words
    assert "not of their type: /text" in words
    with path.open("wb") as file:
        writer = McapWriter(file)
        writer.start("ros2")
        writer.finish()
    assert played_by_cli(ropeway, path)[0] == 0


def test_impossible_stamps_are_told(ropeway: Ropeway, tmp_path: Path) -> None:
    """Stamps of 1970 and of the far future are played without waiting, and it is told."""
    path = tmp_path / "a.mcap"
    with path.open("wb") as file:
        writer = McapWriter(file)
        writer.start("ros2")
        schema = writer.register_schema(STRING, "ros2msg", b"string data\n")
        channel = writer.register_channel("/text", "cdr", schema)
        for stamp in (0, 1_700_000_000 * SECOND, 2**63):
            writer.add_message(channel, stamp, b"\0\1\0\0\1\0\0\0\0", stamp)
        writer.finish()
    status, words = played_by_cli(ropeway, path)
    assert status == 0
    assert "Played 3 messages" in words
    assert "238 years were played as 1 s (2 of them)" in words


@pytest.mark.parametrize("text_", ["/a", "/a:=", "/a b:=/c"])
def test_no_other_name(in_process: Ropeway, tmp_path: Path, text_: str) -> None:
    """A name that is none ends with how to write one."""
    ended = in_process("play", str(tmp_path / "none.mcap"), "-g", "memory:x", "--remap", text_)
    assert ended.returncode == 2


@pytest.fixture
def latched(tmp_path: Path) -> Path:
    """A recording of 2 s with a latched topic and one that is best effort."""
    registry = TypeRegistry()
    files = McapFiles(tmp_path / "latched.mcap")
    once = cdr_channel(registry, "/map", STRING, [LATCHED])
    often = cdr_channel(registry, "/a", STRING, [QoS(reliability="best_effort", depth=3)])
    files.write([Recorded(once, SECOND, text("map")), *(Recorded(often, n * SECOND, text("a")) for n in (1, 2, 3))])
    files.close()
    return files.paths[0]


@pytest.mark.parametrize(
    ("options", "said"),
    [
        (["--remap", "/b:=/c"], "has no topic /b; it has /a, /map"),
        (["--start-offset", "3"], "ends 2.000 s after its beginning"),
        (["--qos-durability", "sometimes"], "Valid options are"),
    ],
)
def test_mistakes(in_process: Ropeway, latched: Path, options: list[str], said: str) -> None:
    """What would play nothing, or something else than was meant, is a mistake that is told."""
    ended = in_process("play", str(latched), "-g", "memory:play-mistakes", "--wait", "0", *options)
    assert ended.returncode != 0
    assert said in ended.stderr
