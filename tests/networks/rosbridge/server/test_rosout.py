"""The gateway's own warnings and errors on ``/rosout``."""

from __future__ import annotations

import asyncio
import itertools
import logging
from collections.abc import AsyncIterator, Iterator
from typing import Any

import pytest

from ropeway.graph.base import Sample
from ropeway.networks.memory.graph import MemoryGraph
from ropeway.networks.rosbridge.server.rosout import LOG_QOS, LOG_TYPE, Rosout
from ropeway.types import TypeRegistry
from tests.support.place import Place
from tests.support.until import until

pytestmark = pytest.mark.jumping

_registry = TypeRegistry()
_numbers = itertools.count()


class Scene:
    """A graph whose log a robot reads, and a logger of its own."""

    def __init__(self) -> None:
        number = next(_numbers)
        self.graph = MemoryGraph(f"rosout-{number}")
        self.robot = MemoryGraph(f"rosout-{number}", node="/robot")
        self.log = logging.getLogger(f"test_rosout_{number}")
        self.log.propagate = False
        self.now = 0.0
        self.messages: list[dict[str, Any]] = []

    async def open(self) -> None:
        await self.graph.open()
        await self.robot.open()
        codec = _registry.codec(LOG_TYPE)

        def heard(batch: Any) -> None:
            self.messages.extend(codec.decode(sample.payload) for sample in batch)

        await self.robot.create_subscription("/rosout", LOG_TYPE, None, heard)

    def rosout(self, **options: Any) -> Rosout:
        return Rosout(self.graph, _registry, source=self.log.name, clock=lambda: self.now, **options)

    @property
    def texts(self) -> list[str]:
        return [message["msg"] for message in self.messages]


@pytest.fixture
async def scene() -> AsyncIterator[Scene]:
    made = Scene()
    await made.open()
    yield made
    await made.robot.close()
    await made.graph.close()


@pytest.fixture
async def rosout(scene: Scene) -> AsyncIterator[Rosout]:
    made = scene.rosout()
    await made.open()
    yield made
    await made.finish()


async def test_warnings_and_errors(scene: Scene, rosout: Rosout) -> None:
    """Warnings and errors are published as ROS has them, what is less important is not."""
    scene.log.setLevel(logging.DEBUG)
    scene.log.info("nothing")
    scene.log.warning("%s is late", "/chatter")
    scene.log.error("gone")
    scene.log.critical("over")
    await until(lambda: len(scene.messages) == 3)
    first = scene.messages[0]
    assert first["msg"] == "/chatter is late"
    assert first["name"] == scene.log.name
    assert (first["file"], first["function"]) == ("test_rosout.py", "test_warnings_and_errors")
    assert first["line"] > 0
    assert first["stamp"]["sec"] > 1_600_000_000
    assert [message["level"] for message in scene.messages] == [30, 40, 50]


async def test_an_exception(scene: Scene, rosout: Rosout) -> None:
    """What was raised is told behind the message."""
    try:
        raise ValueError("no idea")
    except ValueError:
        scene.log.exception("it failed")
    await until(lambda: scene.messages)
    assert scene.texts == ["it failed: ValueError('no idea')"]


async def test_latched(scene: Scene, rosout: Rosout) -> None:
    """The topic has the profile that every node gives it, so that the last messages are there for who comes late."""
    assert [p.qos for p in scene.robot.topics()["/rosout"].publishers] == [LOG_QOS]
    scene.log.warning("early")
    await until(lambda: scene.messages)
    late: list[Sample] = []
    await scene.robot.create_subscription("/rosout", LOG_TYPE, LOG_QOS, late.extend)
    await until(lambda: late)


async def test_from_other_threads(scene: Scene, rosout: Rosout) -> None:
    """Other threads may log, too."""
    await asyncio.gather(*(asyncio.to_thread(scene.log.warning, "thread %d", n) for n in range(10)))
    await until(lambda: len(scene.messages) == 10)
    assert sorted(scene.texts) == [f"thread {n}" for n in range(10)]


async def test_rate(scene: Scene) -> None:
    """Of a flood the first are published, and the next one tells how many were left out."""
    rosout = scene.rosout(rate_hz=2.0, burst=5)
    await rosout.open()
    for number in range(100):
        scene.log.warning("flood %d", number)
    await until(lambda: len(scene.messages) == 5)
    scene.now += 1.0
    scene.log.warning("after")
    scene.log.warning("and on")
    scene.log.warning("too much")
    await until(lambda: len(scene.messages) == 7)
    assert scene.texts[4:] == ["flood 4", "after (before this, 95 messages were left out)", "and on"]
    assert rosout.dropped == 96
    await rosout.finish()


async def test_bounded(scene: Scene) -> None:
    """What waits for the loop is bounded, and so is the length of a message."""
    rosout = scene.rosout(burst=1000)
    await rosout.open()
    for _ in range(300):
        scene.log.warning("x" * 100_000)
    await until(lambda: len(scene.messages) == 256)
    assert rosout.dropped == 44
    assert {len(text) for text in scene.texts} == {4096}
    await rosout.finish()


async def test_what_publishing_logs(scene: Scene, rosout: Rosout, monkeypatch: pytest.MonkeyPatch) -> None:
    """A publisher that logs does not make the log go round in circles."""
    publish = rosout._publisher.publish

    def complaining(sample: Sample) -> None:
        scene.log.error("while publishing")
        publish(sample)

    monkeypatch.setattr(rosout._publisher, "publish", complaining)
    scene.log.warning("once")
    await until(lambda: scene.messages)
    await asyncio.sleep(0)
    assert scene.texts == ["once"]
    assert rosout.dropped == 1


@pytest.fixture
def quiet_failures(monkeypatch: pytest.MonkeyPatch) -> Iterator[None]:
    """``logging`` does not print what a handler could not handle."""
    monkeypatch.setattr(logging, "raiseExceptions", False)
    yield


async def test_bad_records(scene: Scene, rosout: Rosout, quiet_failures: None) -> None:
    """A record whose text cannot be made costs only itself; odd characters are replaced."""

    class Odd:
        def __str__(self) -> str:
            raise RuntimeError

    scene.log.warning("%d", "no number")
    scene.log.warning("%s", Odd())
    scene.log.warning("a\0b \ud800 ü")
    await until(lambda: scene.messages)
    assert scene.texts == ["a b ? ü"]
    assert rosout.dropped == 2


async def test_end(scene: Scene) -> None:
    """At the end what waits is published, the topic withdrawn and the logger left alone."""
    rosout = scene.rosout()
    rosout.emit(logging.makeLogRecord({"msg": "before", "levelno": 40}))
    await rosout.open()
    scene.log.warning("last")
    await rosout.finish()
    await rosout.finish()
    scene.log.warning("after")
    rosout.emit(logging.makeLogRecord({"msg": "after", "levelno": 40}))
    await until(lambda: scene.messages)
    assert scene.texts == ["last"]
    assert rosout not in scene.log.handlers
    assert not scene.robot.topics()["/rosout"].publishers


async def test_clients_see_ros_2(place: Place) -> None:
    """A web client finds a topic of the type by which it knows ROS 2, and reads the gateway's warnings there."""
    client = await place.client()
    client.send({"op": "call_service", "service": "/rosapi/topics_and_raw_types", "id": "1"})
    answer = await client.json()
    assert LOG_TYPE in answer["values"]["types"]
    client.send({"op": "subscribe", "topic": "/rosout"})
    await client.done()
    logging.getLogger("ropeway.test").warning("something is odd")
    while (got := await client.json())["msg"]["msg"] != "something is odd":
        pass
    assert got["msg"]["name"] == "ropeway.test"
