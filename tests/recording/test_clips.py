"""ropeway.recording.clips: what came before a trigger, and after."""

from __future__ import annotations

from pathlib import Path

import pytest

from ropeway.recording.bag import Bag
from ropeway.recording.channel import Recorded
from ropeway.recording.clips import ClipRecorder, stamped
from ropeway.recording.files import McapFiles
from ropeway.recording.ring import Ring
from ropeway.types import TypeRegistry
from tests.recording.test_files import channel
from tests.support.messages import text
from tests.support.until import until

CHANNEL = channel()


def at(second: float) -> Recorded:
    return Recorded(CHANNEL, int(second * 1e9), text(str(second)))


def recorded(path: Path) -> list[bytes]:
    with Bag(path, TypeRegistry()) as bag:
        return [one.payload for one in bag.records(["/a"])]


@pytest.mark.jumping
async def test_before_and_after(tmp_path: Path) -> None:
    """A clip has what the ring had and what came after, complete to the message; the next has it again."""
    done: list[McapFiles] = []
    names = iter("abc")
    clips = ClipRecorder(Ring(3.0, 1 << 20), 2.0, lambda: McapFiles(tmp_path / next(names)), on_clip=done.append)
    for second in range(10):
        clips.put(at(second))
    assert not clips.writing
    clips.trigger("link lost")
    clips.put(at(10))
    clips.put(at(11))
    await until(lambda: len(done) == 1)
    clips.put(at(12))
    clips.trigger("again")
    await clips.close()
    first, second_clip = (files.paths[0] for files in done)
    assert recorded(first) == [text(str(n)) for n in (6, 7, 8, 9, 10, 11)]
    assert recorded(second_clip) == [text(str(n)) for n in (9, 10, 11, 12)]
    assert b"link lost" in first.read_bytes()


@pytest.mark.jumping
async def test_a_trigger_within(tmp_path: Path) -> None:
    """A trigger within a clip makes it longer, and says why in it."""
    done: list[McapFiles] = []
    clips = ClipRecorder(Ring(3.0, 1 << 20), 2.0, lambda: McapFiles(tmp_path / "a"), on_clip=done.append)
    clips.trigger("one")
    clips.trigger("two")
    await until(lambda: len(done) == 1)
    assert (clips.clips, done[0].messages) == (1, 2)
    await clips.close()


async def test_a_clip_that_fails(tmp_path: Path) -> None:
    """A clip that cannot be written is told, and the next may work."""
    (tmp_path / "a.mcap").touch()
    names = iter("ab")
    done: list[McapFiles] = []
    clips = ClipRecorder(Ring(3.0, 1 << 20), 0.0, lambda: McapFiles(tmp_path / next(names)), on_clip=done.append)
    clips.put(at(0))
    clips.trigger("one")
    await until(lambda: clips.failures == 1)
    assert "another name" in clips.error
    clips.trigger("two")
    await until(lambda: len(done) == 1)
    assert (clips.clips, clips.error) == (1, "")
    await clips.close()


def test_names() -> None:
    """Each clip has the time in its name, to the millisecond."""
    assert stamped(Path("d/x.mcap"), 0.25) != stamped(Path("d/x.mcap"), 0.251)
    assert stamped(Path("d/x.mcap"), 0.25).name.endswith("-250.mcap")
    assert stamped(Path("d/x.y"), 0.25).name.startswith("x.y_")
