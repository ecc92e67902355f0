"""ropeway.gateway.recording.recorder: disks that fail, storms of triggers, and a process that is killed."""

from __future__ import annotations

import asyncio
import os
import shutil
import subprocess
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

from ropeway.gateway.config.record_model import RecordConfig
from ropeway.gateway.recording.recorder import Recorder
from ropeway.recording.bag import Bag
from ropeway.recording.channel import Recorded
from ropeway.recording.writer import FAILED
from ropeway.types import TypeRegistry
from tests.recording.test_files import channel, messages
from tests.support.messages import text
from tests.support.until import until

CHANNEL = channel()


def recorder(directory: Path, **config: Any) -> Recorder:
    return Recorder(RecordConfig.model_validate(config), directory, {}, TypeRegistry(), again_s=0.05)


def large(number: int) -> Recorded:
    return Recorded(CHANNEL, 10**18 + number, text("x" * 60_000))


def counted(directory: Path) -> int:
    """Return how many messages of the topic the files have, none of which may be damaged."""
    found = 0
    for path in directory.glob("*.mcap"):
        with Bag(path, TypeRegistry()) as bag:
            assert bag.notes == []
            found += len(list(bag.records(["/a"])))
    return found


@pytest.fixture
def small_disk(tmp_path: Path) -> Iterator[Path]:
    """A disk of 2 MB."""
    if os.geteuid() != 0:
        pytest.skip("a full disk is made by root")
    subprocess.run(["mount", "-t", "tmpfs", "-o", "size=2m", "ropeway-test", tmp_path], check=True)
    yield tmp_path
    subprocess.run(["umount", "-l", tmp_path], check=True)


async def test_a_full_disk(small_disk: Path) -> None:
    """A full disk is told and counted to the message, and once there is room the recorder goes on in another file."""
    made = recorder(small_disk)
    await made.start()
    for number in range(100):
        made.put(large(number))
    await until(lambda: made.state == "failed")
    assert "No space left" in made.status()["error"]
    await until(lambda: made.status()["dropped"].get(FAILED, 0) > 0)
    kept = await asyncio.to_thread(counted, small_disk)
    assert 0 < kept < 100
    assert kept + made.status()["dropped"][FAILED] == 100
    for path in await asyncio.to_thread(lambda: list(small_disk.iterdir())):
        path.unlink()
    await until(lambda: made.state == "recording")
    made.put(large(100))
    await until(lambda: made.status().get("messages") == 1)
    await made.stop()
    assert await asyncio.to_thread(counted, small_disk) == 1


async def test_a_directory_that_vanishes(tmp_path: Path) -> None:
    """A directory that is removed is made again with the next file, and nothing fails."""
    made = recorder(tmp_path / "d", split_bytes=1 << 20, keep_bytes=8 << 20)
    await made.start()
    made.put(large(0))
    await until(lambda: made.status()["messages"] == 1)
    await asyncio.to_thread(shutil.rmtree, tmp_path / "d")
    for number in range(1, 40):
        made.put(large(number))
    await made.stop()
    assert made.status()["error"] == ""
    assert await asyncio.to_thread(counted, tmp_path / "d") > 0


async def test_a_directory_that_cannot_be_written(tmp_path: Path) -> None:
    """A clip that has no place is told as a failure, and the next one may work."""
    (tmp_path / "d").touch()
    made = recorder(tmp_path / "d", ring_s=30, after_s=0)
    await made.start()
    made.put(large(0))
    made.trigger("one")
    await until(lambda: made.status()["failures"] == 1)
    assert made.state == "failed"
    (tmp_path / "d").unlink()
    made.trigger("two")
    await until(lambda: made.status()["clips"] == 1)
    assert made.state == "waiting"
    await made.stop()
    assert await asyncio.to_thread(counted, tmp_path / "d") == 1


async def test_a_storm_of_triggers(tmp_path: Path) -> None:
    """However often it is triggered, clips follow one another, each with the ring complete, within the bound."""
    made = recorder(tmp_path, ring_s=30, after_s=0, keep_bytes=8 << 20)
    await made.start()
    for number, message in enumerate(messages(CHANNEL, 200)):
        made.put(message)
        if number >= 100:
            for _ in range(50):
                made.trigger("storm")
            await asyncio.sleep(0)
    await until(lambda: made.state == "waiting")
    status = made.status()
    assert status["triggers"] == 5_000
    assert 1 <= status["clips"] <= 101
    await made.stop()
    paths = await asyncio.to_thread(lambda: sorted(tmp_path.glob("*.mcap")))
    assert sum(path.stat().st_size for path in paths) <= 8 << 20
    with Bag(paths[-1], TypeRegistry()) as bag:
        found = [one.payload for one in bag.records(["/a"])]
    assert found == [text(str(number)) for number in range(len(found))]
    assert len(found) > 100


async def test_a_clip_larger_than_what_may_wait(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """A clip is complete to the message also where the ring has more than may wait for the disk."""
    monkeypatch.setattr("ropeway.recording.clips.RECORDING_WAITING_BYTES", 1_000)
    made = recorder(tmp_path, ring_s=30, after_s=0)
    await made.start()
    for number in range(300):
        made.put(large(number))
    made.trigger("now")
    await until(lambda: made.status()["clips"] == 1)
    await made.stop()
    assert await asyncio.to_thread(counted, tmp_path) == 300
    assert made.status()["dropped"] == {}
