"""ropeway.gateway.recording.recorders: what crosses a gateway is recorded, and what happens to its links."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import pytest

from ropeway.errors import ConfigError
from ropeway.gateway.config.config import parse
from ropeway.gateway.gateway import Gateway
from ropeway.recording.bag import Bag
from ropeway.recording.sources import open_recording
from ropeway.types import TypeRegistry
from tests.support.inbox import Inbox
from tests.support.messages import STRING, sample, text
from tests.support.until import until
from tests.support.world import World, url


def topics(*names: str, **more: Any) -> list[dict[str, Any]]:
    return [{"name": name, "type": STRING, **more} for name in names]


def files(directory: Path) -> list[Path]:
    return sorted(directory.rglob("*.mcap"))


def recorded(directory: Path, topic: str) -> list[bytes]:
    """Return the payloads of a topic in all files, also of what is no CDR."""
    found: list[tuple[int, bytes]] = []
    for path in files(directory):
        if not path.stat().st_size:
            continue
        with open_recording(path) as recording:
            ids = [channel.id for channel in recording.channels if channel.topic == topic]
            found += [(time_ns, raw) for _, time_ns, raw in recording.messages(ids)] if ids else []
    return [raw for _, raw in sorted(found)]


def told(directory: Path, topic: str) -> list[dict[str, Any]]:
    return [json.loads(raw) for raw in recorded(directory, topic)]


class Pair:
    """A robot that dials a cloud, with a recorder at the robot."""

    def __init__(self, world: World, directory: Path) -> None:
        self.world, self.directory = world, directory

    async def start(self, record: Any, remote: dict[str, Any]) -> None:
        self.cloud = await self.world.gateway("cloud", [])
        self.remote = {"address": url(self.cloud), **remote}
        self.robot = await self.world.gateway("robot", [self.remote], record=record, listen=[])
        self.here, self.there = await self.world.robot("robot"), await self.world.robot("cloud")

    async def apply(self, record: Any) -> None:
        document = self.robot.config.to_json()
        document["gateway"]["record"] = record
        await self.robot.apply(parse(document))

    def state(self, name: str = "recording") -> dict[str, Any]:
        return next(row for row in self.robot.status()["recordings"] if row["name"] == name)


@pytest.fixture
def pair(world: World, tmp_path: Path) -> Pair:
    return Pair(world, tmp_path)


async def exchange(pair: Pair, topic: str, *payloads: str) -> None:
    """Publish at the robot what is read at the cloud, and wait until it is there."""
    inbox = Inbox()
    subscription = await pair.there.create_subscription(topic, STRING, None, inbox)
    publisher = await pair.here.create_publisher(topic, STRING)
    await until(lambda: publisher.subscribers)
    for payload in payloads:
        publisher.publish(sample(payload))
        await inbox.wait(1)
        inbox.samples.clear()
    await publisher.close()
    await subscription.close()


async def test_what_crosses_is_recorded(pair: Pair) -> None:
    """Messages of the routes that a recorder wants are in its file, both ways; others are not."""
    await pair.start(
        {"directory": str(pair.directory), "exclude": ["/secret"]},
        {"publish": topics("/a", "/secret", "/unread"), "subscribe": topics("/b")},
    )
    unread = await pair.here.create_publisher("/unread", STRING)
    unread.publish(sample("nobody reads it"))
    await exchange(pair, "/a", "1", "2")
    await exchange(pair, "/secret", "3")
    inbox = Inbox()
    await pair.here.create_subscription("/b", STRING, None, inbox)
    publisher = await pair.there.create_publisher("/b", STRING)
    await until(lambda: publisher.subscribers)
    publisher.publish(sample("4"))
    await inbox.wait(1)
    await pair.robot.recorders.stop("")
    assert recorded(pair.directory, "/a") == [text("1"), text("2")]
    assert recorded(pair.directory, "/b") == [text("4")]
    assert recorded(pair.directory, "/secret") == recorded(pair.directory, "/unread") == []
    (path,) = files(pair.directory)
    assert path.parent == pair.directory / "recording"
    with Bag(path, TypeRegistry()) as bag:
        assert {one.name: one.type for one in bag.topics if not one.problem} == {"/a": STRING, "/b": STRING}


async def test_nothing_is_on_the_way_of_what_is_not_recorded(pair: Pair) -> None:
    """A route that nobody records has no tap and no step more, before, while and after others are recorded."""
    await pair.start(
        {"directory": str(pair.directory), "routes": ["/a"], "active": False}, {"publish": topics("/a", "/b")}
    )

    def taps() -> dict[str, bool]:
        return {one.route.name: one.bridge.options.tap is not None for one in pair.robot.remotes[0].joined()}

    assert taps() == {"/a": False, "/b": False}
    assert pair.state()["state"] == "stopped"
    await pair.robot.recorders.start("recording")
    assert taps() == {"/a": True, "/b": False}
    await pair.robot.recorders.stop("recording")
    assert taps() == {"/a": False, "/b": False}
    assert all(not one.bridge.passage.steps for one in pair.robot.remotes[0].joined())


async def test_links_and_drops(pair: Pair) -> None:
    """The state of the link is recorded at each change, with its figures; what a route drops with count and reason."""
    await pair.start({"directory": str(pair.directory)}, {"publish": topics("/a", rate_hz=0.01)})
    await until(lambda: pair.robot.remotes[0].state == "connected")
    inbox = Inbox()
    await pair.there.create_subscription("/a", STRING, None, inbox)
    publisher = await pair.here.create_publisher("/a", STRING)
    await until(lambda: publisher.subscribers)
    for number in range(5):
        publisher.publish(sample(str(number)))
    await inbox.wait(1)
    route = pair.robot.remotes[0].joined()[0].bridge
    await until(lambda: sum(route.drops.values()) == 4)
    await until(lambda: any("rtt_ms" in one for one in told(pair.directory, "/ropeway/links")))
    await pair.cloud.__aexit__(None, None, None)
    await until(lambda: pair.robot.remotes[0].state != "connected")
    await until(
        lambda: any(one["before"] == "connected" != one["state"] for one in told(pair.directory, "/ropeway/links"))
    )
    await pair.robot.recorders.stop("")
    links = told(pair.directory, "/ropeway/links")
    changes = [(one["before"], one["state"]) for one in links if one["before"] != one["state"]]
    assert any(state == "connected" for _, state in changes)
    assert [(one["route"], one["count"]) for one in told(pair.directory, "/ropeway/drops")] == [("publish /a", 4)]


async def test_a_lost_link_writes_a_clip(pair: Pair) -> None:
    """The loss of a link writes what crossed before it and what came after, and says why."""
    await pair.start(
        {"directory": str(pair.directory), "ring_s": 30, "after_s": 0.5, "link_loss": True}, {"publish": topics("/a")}
    )
    await exchange(pair, "/a", *map(str, range(20)))
    await until(lambda: pair.state()["ring"]["messages"] > 20)
    assert files(pair.directory) == []
    await pair.cloud.__aexit__(None, None, None)
    await until(lambda: pair.state()["clips"] == 1)
    assert recorded(pair.directory, "/a") == [text(str(number)) for number in range(20)]
    (why,) = {one["why"].partition(" is lost")[0] for one in told(pair.directory, "/ropeway/triggers")}
    assert why == f"the link to {pair.remote['address']}"
    assert pair.state()["last"] == str(files(pair.directory)[0])


async def test_conditions_and_topics_of_a_graph(pair: Pair) -> None:
    """Topics of a local network are recorded whether they cross or not, and a condition on one writes a clip."""
    await pair.start(
        {
            "directory": str(pair.directory),
            "topics": ["/local/*"],
            "ring_s": 30,
            "after_s": 0,
            "when": ["/alarm.data == yes_it_is"],
        },
        {},
    )
    local = await pair.here.create_publisher("/local/x", STRING)
    alarm = await pair.here.create_publisher("/alarm", STRING)
    await until(lambda: local.subscribers and alarm.subscribers)
    local.publish(sample("1"))
    alarm.publish(sample("no"))
    await until(lambda: pair.state()["ring"]["messages"] >= 1)
    alarm.publish(sample("yes_it_is"))
    await until(lambda: pair.state()["clips"] == 1)
    assert recorded(pair.directory, "/local/x") == [text("1")]


async def test_a_running_gateway_is_changed(pair: Pair) -> None:
    """Recorders come, change and go while the gateway runs, and those that stay the same go on with their file."""
    await pair.start([], {"publish": topics("/a")})
    assert "recordings" not in pair.robot.status()
    first = {"directory": str(pair.directory), "name": "first"}
    await pair.apply([first])
    await exchange(pair, "/a", "1")
    await pair.apply([first, {**first, "name": "second"}])
    await exchange(pair, "/a", "2")
    await pair.apply([])
    await exchange(pair, "/a", "3")
    assert recorded(pair.directory / "first", "/a") == [text("1"), text("2")]
    assert recorded(pair.directory / "second", "/a") == [text("2")]
    assert len(files(pair.directory / "first")) == 1
    with pytest.raises(ConfigError, match=r"gateway\.record\[0\]\.directory"):
        await pair.apply([{"directory": str(files(pair.directory)[0])}])
    assert pair.robot.config.gateway.record == ()


async def test_a_directory_that_cannot_be(world: World, tmp_path: Path) -> None:
    """A gateway whose recordings have no place does not come up, and says which key is wrong."""
    (tmp_path / "file").touch()
    with pytest.raises(ConfigError, match=r"gateway\.record\[0\]\.directory"):
        await world.gateway("robot", [], record={"directory": str(tmp_path / "file")})


async def test_a_trigger_needs_a_ring(pair: Pair) -> None:
    """An order to write a clip reaches the recorders that have a ring and run, and no others."""
    ring = {"directory": str(pair.directory), "ring_s": 5, "after_s": 0}
    await pair.start(
        [{**ring, "name": "ring"}, {**ring, "name": "off", "active": False}, {"directory": str(pair.directory)}], {}
    )
    assert pair.robot.recorders.names == ["ring", "off", "recording"]
    assert pair.robot.recorders.trigger("", "an order") == ["ring"]
    assert pair.robot.recorders.trigger("recording", "an order") == []
    await until(lambda: pair.state("ring")["clips"] == 1)
    listed = {row["name"]: row["files"] for row in pair.robot.recorders.listed()}
    assert len(listed["ring"]) == 1
    assert isinstance(pair.robot, Gateway)
