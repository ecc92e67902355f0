"""``ropeway record`` and ``ropeway bag info`` as a user runs them."""

from __future__ import annotations

import asyncio
import json
import signal
import sys
from collections.abc import AsyncIterator
from pathlib import Path

import pytest

from ropeway import aio
from ropeway.networks.dds import DdsGraph
from ropeway.qos import LATCHED, QoS
from tests.cli.conftest import Ropeway
from tests.support.messages import STRING, sample
from tests.support.until import PATIENCE_S, until

WHOLE = QoS(durability="transient_local", depth=100)  # whoever is matched late gets all of it


@pytest.fixture
async def robot(environment: dict[str, str], monkeypatch: pytest.MonkeyPatch) -> AsyncIterator[DdsGraph]:
    """A participant on the network of the processes."""
    monkeypatch.setenv("ROS_AUTOMATIC_DISCOVERY_RANGE", environment["ROS_AUTOMATIC_DISCOVERY_RANGE"])
    graph = DdsGraph(int(environment["ROS_DOMAIN_ID"]), name="robot")
    await graph.open()
    yield graph
    await graph.close()


async def start(environment: dict[str, str], *arguments: str) -> asyncio.subprocess.Process:
    return await asyncio.create_subprocess_exec(
        sys.executable, "-m", "ropeway", *arguments, stdout=-1, stderr=-1, env=environment
    )


async def finished(process: asyncio.subprocess.Process) -> tuple[int, str, str]:
    process.send_signal(signal.SIGINT)
    async with aio.timeout(PATIENCE_S):
        out, err = await process.communicate()
    return process.returncode or 0, out.decode(), err.decode()


async def test_record(robot: DdsGraph, environment: dict[str, str], tmp_path: Path, in_process: Ropeway) -> None:
    """What is published is in the file when Ctrl-C ends the recording, and ``bag info`` tells what it has."""
    (await robot.create_publisher("/map", STRING, LATCHED)).publish(sample("map"))
    moving = await robot.create_publisher("/moving", STRING, WHOLE)
    file = tmp_path / "a.mcap"
    process = await start(environment, "record", "-a", "-o", str(file), "--json")
    await until(lambda: moving.subscribers == 1)
    for number in range(50):
        moving.publish(sample(str(number)))
    moving.publish(sample("x" * 5_000_000))  # more than a file holds back
    await until(lambda: file.exists() and file.stat().st_size > 4_000_000)
    code, out, _ = await finished(process)
    told = json.loads(out)
    assert (code, told["messages"], told["dropped"]) == (0, 52, {})
    shown = json.loads(in_process("bag", "info", str(file), "--json").stdout)
    assert {one["name"]: one["count"] for one in shown["topics"]} == {"/map": 1, "/moving": 51}
    text = in_process("bag", "info", str(file)).stdout
    assert "Messages:  52" in text
    assert "latched" in text


async def test_clips(robot: DdsGraph, environment: dict[str, str], tmp_path: Path) -> None:
    """With a ring a clip is written when a condition becomes true, with what came before it."""
    state = await robot.create_publisher("/state", STRING, WHOLE)
    process = await start(
        environment, "record", "/state", "-o", str(tmp_path / "c"), "--json",
        "--ring", "30", "--after", "0.2", "--when", "/state.data == lost",
    )  # fmt: skip
    await until(lambda: state.subscribers == 1)
    for value in ("well", "well", "lost"):
        state.publish(sample(value))
    assert process.stdout is not None
    async with aio.timeout(PATIENCE_S):
        clip = json.loads(await process.stdout.readline())
    assert clip["messages"] == 4  # three, and why
    code, out, _ = await finished(process)
    assert (code, json.loads(out)["clips"]) == (0, [clip["clip"]])


@pytest.mark.parametrize(
    ("arguments", "told"),
    [
        ([], "nothing to record"),
        (["-a", "--when", "/a.x < 1"], "--when needs --ring"),
        (["-a", "--ring", "3", "--when", "/a < 1"], "is not a condition"),
        (["-a", "--compression", "rar"], "is not a compression"),
        (["-e", "("], "is not a regular expression"),
    ],
)
def test_wrong_options(in_process: Ropeway, arguments: list[str], told: str) -> None:
    """Options that do not go together end with a sentence."""
    ended = in_process("record", *arguments, "-g", "memory:x")
    assert ended.returncode == 2
    assert told in ended.stderr
