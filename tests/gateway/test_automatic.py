"""ropeway.gateway.automatic: topics are shared as the local graph needs them, each on its own."""

from __future__ import annotations

import itertools
import logging
from collections.abc import AsyncIterator
from contextlib import AsyncExitStack
from typing import Any

import pytest

from ropeway.gateway.automatic import Automatic
from ropeway.gateway.config.config import parse
from ropeway.gateway.config.model import RemoteConfig
from ropeway.gateway.gateway import Gateway
from ropeway.graph.base import EndpointInfo, TopicInfo
from ropeway.networks.memory.graph import MemoryGraph
from ropeway.qos import DEFAULT
from tests.support.messages import STRING
from tests.support.until import until

_numbers = itertools.count()


class Odd(MemoryGraph):
    """A network on which other programs name topics as they like."""

    odd: tuple[str, ...] = ()
    broken = False

    def topics(self) -> dict[str, TopicInfo]:
        if self.broken:
            raise RuntimeError("discovery failed")
        found = super().topics()
        for name in self.odd:
            publisher = EndpointInfo("publisher", name, STRING, DEFAULT, gid=b"1", node="/x")
            found[name] = TopicInfo(name, (STRING,), (publisher,), ())
        return dict(sorted(found.items()))


class Place:
    """A local network with a robot, and a remote one."""

    def __init__(self, stack: AsyncExitStack) -> None:
        number = next(_numbers)
        self.stack = stack
        self.local = Odd(f"automatic-near-{number}", node="/gateway")
        self.robot = MemoryGraph(f"automatic-near-{number}", node="/robot")
        self.remote = MemoryGraph(f"automatic-far-{number}", node="/gateway")

    async def start(self) -> Automatic:
        for graph in (self.local, self.robot, self.remote):
            await graph.open()
            self.stack.push_async_callback(graph.close)
        config = RemoteConfig.model_validate({"address": "overlay", "automatic": {"allow": ["*"]}})
        made = Automatic(self.local, self.remote, config, "remotes[0].automatic", "memory", Gateway(parse([])))
        await made.start()
        self.stack.push_async_callback(made.close)
        return made

    def shared(self) -> set[str]:
        return {name for name, topic in self.remote.topics().items() if topic.publishers}


@pytest.fixture
async def place() -> AsyncIterator[Place]:
    async with AsyncExitStack() as stack:
        yield Place(stack)


async def test_a_topic_with_an_odd_name_is_left_out_alone(place: Place, caplog: pytest.LogCaptureFixture) -> None:
    """A topic that ROS would not take is named in log and status; the others are shared and withdrawn as ever."""
    caplog.set_level(logging.WARNING)
    place.local.odd = ("/1st", "/a b", "rt//x", "//x", "/x/")
    automatic = await place.start()
    good = await place.robot.create_publisher("/good1", STRING)
    await until(lambda: place.shared() == {"/good1"})
    left_out: dict[str, Any] = automatic.status()["left_out"]
    assert set(left_out) == {"/1st", "/a b", "rt//x", "//x", "/x/"}
    assert automatic.status()["state"] == "running"
    assert sum("left out" in message for message in caplog.messages) == 1
    await place.robot.create_publisher("/good2", STRING)
    await until(lambda: place.shared() == {"/good1", "/good2"})
    place.local.odd = ()
    await good.close()
    await until(lambda: place.shared() == {"/good2"})
    assert automatic.status()["left_out"] == {}


async def test_a_failure_is_seen_and_got_over(place: Place) -> None:
    """A graph whose discovery fails makes the automatic mode `failed`, with the reason, until it works again."""
    place.local.broken = True
    automatic = await place.start()
    await until(lambda: automatic.status()["state"] == "failed")
    assert automatic.status()["error"] == "RuntimeError: discovery failed"
    place.local.broken = False
    await place.robot.create_publisher("/good", STRING)
    await until(lambda: place.shared() == {"/good"})
    assert automatic.status() == {"state": "running", "error": "", "shared": 1, "left_out": {}}
