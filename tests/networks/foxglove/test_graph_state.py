"""Who uses what, as viewers are shown it, and the time of a simulation."""

from __future__ import annotations

import struct
from typing import Any

from ropeway.graph.base import SEQ_NONE, Sample
from ropeway.networks.foxglove.settings import FoxgloveSettings
from ropeway.qos import QoS
from tests.networks.foxglove.viewer import Sight, Viewer
from tests.support.inbox import Inbox
from tests.support.messages import STRING, joined, sample
from tests.support.services import ADD, add
from tests.support.until import until

CLOCK = "rosgraph_msgs/msg/Clock"


async def update(viewer: Viewer, condition: Any) -> dict[str, Any]:
    """Wait for an update of which a condition holds."""
    while True:
        found = await viewer.op("connectionGraphUpdate")
        if condition(found):
            return found


async def test_the_graph_is_shown(sight: Sight) -> None:
    """A viewer that asks is told everything once and then what changes, and nothing after it asked no more."""
    publisher = await sight.robot.create_publisher("/a", STRING)
    await sight.robot.create_service("/add", ADD, add)
    viewer = await sight.viewer()
    viewer.send({"op": "subscribeConnectionGraph"})
    first = await viewer.op("connectionGraphUpdate")
    assert {"name": "/a", "publisherIds": ["/robot"]} in first["publishedTopics"]
    assert {"name": "/add", "providerIds": ["/robot"]} in first["advertisedServices"]
    await sight.robot.create_subscription("/a", STRING, QoS(), Inbox())
    changed = await update(viewer, lambda told: told["subscribedTopics"])
    assert changed["subscribedTopics"] == [{"name": "/a", "subscriberIds": ["/robot"]}]
    assert changed["publishedTopics"] == []
    await publisher.close()
    gone = await update(viewer, lambda told: told["publishedTopics"])
    assert gone["publishedTopics"] == [{"name": "/a", "publisherIds": []}]
    assert gone["removedTopics"] == []
    viewer.send({"op": "unsubscribeConnectionGraph"})
    await viewer.passed()
    await sight.robot.create_publisher("/b", STRING)
    await viewer.channel("/b")
    assert not [told for told in viewer.told if told["op"] == "connectionGraphUpdate"]


async def test_topics_that_go(sight: Sight) -> None:
    """A topic that nobody uses any more is removed."""
    publisher = await sight.robot.create_publisher("/a", STRING)
    viewer = await sight.viewer()
    viewer.send({"op": "subscribeConnectionGraph"})
    await viewer.op("connectionGraphUpdate")
    await publisher.close()
    assert "/a" in (await update(viewer, lambda told: told["removedTopics"]))["removedTopics"]


async def test_the_time_of_a_simulation(dark: Sight) -> None:
    """With ``use_sim_time`` viewers are told the time of /clock, and messages have it as theirs."""
    await dark.start(FoxgloveSettings(sim_time=True))
    clock = await dark.robot.create_publisher("/clock", CLOCK)
    publisher = await dark.robot.create_publisher("/a", STRING)
    assert clock.subscribers == 0
    viewer = await dark.viewer()
    assert "time" in (await viewer.op("serverInfo"))["capabilities"]
    await viewer.subscribe("/a")
    await joined(publisher)
    await joined(clock)
    payload = dark.registry.codec(CLOCK).encode({"clock": {"sec": 7, "nanosec": 5}})
    clock.publish(Sample(payload, CLOCK, 0, bytes(16), SEQ_NONE))
    await viewer.until(lambda: viewer.binary)
    assert struct.unpack("<BQ", viewer.binary[0]) == (2, 7_000_000_005)
    publisher.publish(sample("x"))
    assert (await viewer.message()).stamp_ns == 7_000_000_005
    viewer.abort()
    await until(lambda: clock.subscribers == 0)
