"""What all viewers share: changes of parameters and the time of a simulation, read while somebody wants them."""

from __future__ import annotations

from typing import Any

from ropeway.graph.base import SEQ_NONE, Sample
from ropeway.graph.parameters import to_message
from ropeway.networks.foxglove.events import clock, parameter_events
from ropeway.qos import QoS
from tests.networks.foxglove.viewer import Sight
from tests.support.messages import joined
from tests.support.until import until

EVENT, CLOCK = "rcl_interfaces/msg/ParameterEvent", "rosgraph_msgs/msg/Clock"


def sample(sight: Sight, type: str, value: dict[str, Any]) -> Sample:
    """Return a message of a type."""
    return Sample(sight.registry.codec(type).encode(value), type, 0, bytes(16), SEQ_NONE)


async def test_changes_of_parameters(sight: Sight) -> None:
    """New, changed and deleted parameters are told by their full names; what cannot be read costs nothing else."""
    changed: list[tuple[str, Any]] = []
    events = parameter_events(sight.hub.view("test"), sight.registry, lambda name, value: changed.append((name, value)))
    await events.settle(lambda: True)
    publisher = await sight.robot.create_publisher("/parameter_events", EVENT, QoS(depth=10))
    await joined(publisher)
    publisher.publish(Sample(b"\0\1\0\0\xff", EVENT, 0, bytes(16), SEQ_NONE))
    event = {
        "node": "/n",
        "new_parameters": [{"name": "a", "value": to_message(1)}],
        "changed_parameters": [{"name": "b", "value": to_message("x")}],
        "deleted_parameters": [{"name": "c"}],
    }
    publisher.publish(sample(sight, EVENT, event))
    await until(lambda: len(changed) == 3)
    assert changed == [("/n.a", 1), ("/n.b", "x"), ("/n.c", None)]
    await events.settle(lambda: False)
    await until(lambda: publisher.subscribers == 0)


async def test_time(sight: Sight) -> None:
    """The time is told in nanoseconds, and never before the beginning; a message that cannot be read is left out."""
    told: list[int] = []
    time = clock(sight.hub.view("test"), sight.registry, told.append)
    publisher = await sight.robot.create_publisher("/clock", CLOCK)
    await time.settle(lambda: True)
    await time.settle(lambda: True)
    await joined(publisher)
    assert publisher.subscribers == 1
    for seconds in (2, -5):
        publisher.publish(sample(sight, CLOCK, {"clock": {"sec": seconds, "nanosec": 7}}))
        await until(lambda: told)
        assert told.pop() == max(seconds * 10**9 + 7, 0)
    publisher.publish(Sample(b"\0\1\0\0", CLOCK, 0, bytes(16), SEQ_NONE))
    publisher.publish(sample(sight, CLOCK, {"clock": {"sec": 3, "nanosec": 0}}))
    await until(lambda: told)
    assert told == [3 * 10**9]
    await time.settle(lambda: False)
    await until(lambda: publisher.subscribers == 0)
