"""A channel that a viewer reads."""

from __future__ import annotations

from ropeway.delivery.outbox import Lost
from ropeway.errors import TypesError
from ropeway.networks.foxglove.channels import TopicChannel
from ropeway.networks.foxglove.reading import ChannelReader
from ropeway.networks.foxglove.settings import FoxgloveSettings, patterns
from ropeway.qos import LATCHED, SENSOR_DATA, QoS
from tests.networks.foxglove.viewer import Sight
from tests.support.messages import STRING, joined, sample
from tests.support.until import until


async def test_best_effort_where_it_is_asked_for(dark: Sight) -> None:
    """Topics of ``best_effort_qos_topic_whitelist`` are read as best effort, others as their publishers offer."""
    await dark.start(FoxgloveSettings(best_effort=patterns(("/fast",))))
    for name in ("/fast", "/sure"):
        await dark.robot.create_publisher(name, STRING, QoS())
    await dark.robot.create_publisher("/sensor", STRING, SENSOR_DATA)
    viewer = await dark.viewer()
    for number, name in enumerate(("/fast", "/sure", "/sensor")):
        await viewer.subscribe(name, number)
    await viewer.passed()

    def asked(name: str) -> str:
        return dark.hub.subscriptions[name][0].qos.reliability

    assert [asked(name) for name in ("/fast", "/sure", "/sensor")] == ["best_effort", "reliable", "best_effort"]


async def test_as_many_as_the_publisher_keeps(dark: Sight) -> None:
    """The queue of a channel follows the profile of its publishers, within the bounds of the settings."""
    await dark.start(FoxgloveSettings(min_depth=2, max_depth=8))
    for name, qos in (("/one", QoS(depth=1)), ("/five", QoS(depth=5)), ("/many", QoS(depth=500)), ("/map", LATCHED)):
        await dark.robot.create_publisher(name, STRING, qos)
    viewer = await dark.viewer()
    for number, name in enumerate(("/one", "/five", "/many", "/map")):
        await viewer.subscribe(name, number)
    await viewer.passed()
    queues = [reader._queue for reader in dark.session._readers.values()]
    assert [(queue.depth, queue.latched) for queue in queues] == [(2, False), (5, False), (8, False), (2, True)]


async def test_a_channel_that_is_left(sight: Sight) -> None:
    """What comes after a viewer has left a channel goes nowhere, and its queue is gone."""
    publisher = await sight.robot.create_publisher("/chatter", STRING)
    viewer = await sight.viewer()
    await viewer.subscribe("/chatter")
    await joined(publisher)
    (reader,) = sight.session._readers.values()
    viewer.send({"op": "unsubscribe", "subscriptionIds": [1]})
    await until(lambda: publisher.subscribers == 0)
    await viewer.passed()
    reader.passage.pass_on([sample("late")])
    assert (sight.session.sender.outbox.messages, viewer.messages) == (0, [])
    assert reader._queue.lost[Lost.UNSENT] == 0


async def test_what_cannot_be_written(sight: Sight) -> None:
    """A message that cannot be written for viewers is counted under the name of its topic."""
    viewer = await sight.viewer()
    await viewer.op("serverInfo")
    reader = ChannelReader(sight.session, 1, TopicChannel(1, "/a", STRING, b"", False))
    reader.unreadable(TypesError(STRING, "no codec"))
    assert sight.session.fault_log.counts["message", "/a"] == 1
    await reader.close()
