"""Reads for all viewers what they cannot read themselves: changes of parameters, and the time of a simulation.

Both topics are read while a viewer wants them, and no longer.
"""

from __future__ import annotations

import asyncio
import logging
from collections.abc import Callable, Sequence
from typing import TYPE_CHECKING, Any, Final

from ropeway.errors import RopewayError, TypesError
from ropeway.graph.parameters import from_message
from ropeway.qos import QoS

if TYPE_CHECKING:
    from ropeway.graph.base import Sample, Subscription
    from ropeway.hub.hub import View
    from ropeway.types import TypeRegistry

__all__ = ["SharedTopic", "clock", "parameter_events"]

log = logging.getLogger("ropeway.server")

_EVENTS: Final = ("/parameter_events", "rcl_interfaces/msg/ParameterEvent")
_CLOCK: Final = ("/clock", "rosgraph_msgs/msg/Clock")


class SharedTopic:
    """A topic that is read once for all viewers, while it is ``wanted``."""

    def __init__(self, view: View, topic: str, type: str, qos: QoS, take: Callable[[Sequence[Sample]], None]) -> None:
        self._view, self._topic, self._type, self._qos, self._take = view, topic, type, qos, take
        self._subscription: Subscription | None = None
        self._lock = asyncio.Lock()

    async def settle(self, wanted: Callable[[], bool]) -> None:
        """Read the topic if it is ``wanted`` once this has its turn, and stop reading if it is not."""
        async with self._lock:
            if wanted() and self._subscription is None:
                try:
                    self._subscription = await self._view.create_subscription(
                        self._topic, self._type, self._qos, self._take
                    )
                except RopewayError as error:
                    log.warning("%s cannot be read for viewers: %s", self._topic, error)
            elif not wanted() and self._subscription is not None:
                subscription, self._subscription = self._subscription, None
                await subscription.close()


def parameter_events(view: View, registry: TypeRegistry, changed: Callable[[str, Any], None]) -> SharedTopic:
    """Return the topic on which nodes tell changes of their parameters; ``changed`` gets each by its full name."""

    def take(batch: Sequence[Sample]) -> None:
        for sample in batch:
            try:
                event = registry.codec(_EVENTS[1]).decode(sample.payload)
            except TypesError as error:
                log.debug("a change of parameters cannot be read: %s", error)
                continue
            for parameter in (*event["new_parameters"], *event["changed_parameters"]):
                changed(f"{event['node']}.{parameter['name']}", from_message(parameter["value"]))
            for parameter in event["deleted_parameters"]:
                changed(f"{event['node']}.{parameter['name']}", None)

    return SharedTopic(view, *_EVENTS, QoS(depth=1000), take)


def clock(view: View, registry: TypeRegistry, told: Callable[[int], None]) -> SharedTopic:
    """Return the topic with the time of a simulation; ``told`` gets it in nanoseconds."""

    def take(batch: Sequence[Sample]) -> None:
        try:
            now = registry.codec(_CLOCK[1]).decode(batch[-1].payload)["clock"]
        except TypesError as error:
            log.debug("a time cannot be read: %s", error)
            return
        told(max(now["sec"] * 1_000_000_000 + now["nanosec"], 0))

    return SharedTopic(view, *_CLOCK, QoS(reliability="best_effort", depth=1), take)
