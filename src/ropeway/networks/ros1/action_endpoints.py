"""The five topics that an action of actionlib is made of, as raw ends of one node."""

from __future__ import annotations

import logging
from collections.abc import Callable
from typing import TYPE_CHECKING

from ropeway.errors import DecodeError
from ropeway.graph.base import Undelivered
from ropeway.networks.ros1.reader import Batch, TopicReader, reader_of
from ropeway.networks.ros1.writer import RawPublisher, writer_of
from ropeway.qos import QoS

if TYPE_CHECKING:
    from ropeway.networks.ros1.master_registration import MasterRegistration
    from ropeway.networks.ros1.node import Ros1Node
    from ropeway.types.ros1_convert import Converter

__all__ = ["ActionTypes", "RawSubscription", "publish_raw", "subscribe_raw"]

log = logging.getLogger("ropeway.ros1")


class ActionTypes:
    """The types of ``pkg/action/Name``, and what converts goal, result and feedback. Raises ``TypesError``."""

    def __init__(self, node: Ros1Node, type: str) -> None:
        package, _, name = type.split("/")
        self.goal = f"{package}/msg/{name}ActionGoal"
        self.result = f"{package}/msg/{name}ActionResult"
        self.feedback = f"{package}/msg/{name}ActionFeedback"
        self._types = node.types
        self._parts = {
            part: (f"{type}_{part}", f"{package}/msg/{name}{part}") for part in ("Goal", "Result", "Feedback")
        }
        for ours, theirs in self._parts.values():
            node.types.converter(ours, theirs)
        self.no_result = node.types.registry.codec(f"{type}_Result").encode({})

    @property
    def of_goal(self) -> Converter:
        """Converts goals; may change when a peer tells more of the type, as the others."""
        return self._types.converter(*self._parts["Goal"])

    @property
    def of_result(self) -> Converter:
        """Converts results."""
        return self._types.converter(*self._parts["Result"])

    @property
    def of_feedback(self) -> Converter:
        """Converts feedback."""
        return self._types.converter(*self._parts["Feedback"])


class RawSubscription:
    """A topic read as ROS 1 serialises it; ``take`` gets each message and who sent it."""

    def __init__(self, reader: TopicReader, take: Callable[[bytes, str], None], on_links: Callable[[], None]) -> None:
        self.topic = reader.topic
        self._reader, self._take, self._on_links = reader, take, on_links
        self._blamed = False
        reader.users.append(self)
        for link in reader.links:
            if (batch := link.latest) is not None:
                self.take(batch)

    @property
    def publishers(self) -> int:
        """The number of connected publishers."""
        return len(self._reader.links)

    def take(self, batch: Batch) -> None:
        """Take messages; see ``Consumer``."""
        for raw in batch.raws:
            try:
                self._take(raw, batch.link.caller)
            except DecodeError as error:
                node = self._reader.node
                node.graph.drops[self.topic, Undelivered.DECODE] += 1
                if not self._blamed:
                    self._blamed = True
                    log.warning("%s: a message of %s is unreadable: %s", node.graph.name, self.topic, error)

    def links_changed(self) -> None:
        """Take a change of connections; see ``Consumer``."""
        self._on_links()

    async def close(self) -> None:
        """Stop reading."""
        await self._reader.leave(self)


async def publish_raw(keeper: MasterRegistration, topic: str, type: str, qos: QoS) -> RawPublisher:
    """Publish messages of the ROS 1 type ``pkg/msg/Name``. Raises ``TypesError``."""
    node = keeper.node
    stamped = node.types.definition(type).name != "actionlib_msgs/msg/GoalID"
    writer = writer_of(node, topic, node.types.message(type))
    made = RawPublisher(writer, type, qos, stamped=stamped)
    if not writer.registered:
        await keeper.register(writer)
    return made


async def subscribe_raw(
    keeper: MasterRegistration, topic: str, type: str, take: Callable[[bytes, str], None], on_links: Callable[[], None]
) -> RawSubscription:
    """Read messages of the ROS 1 type ``pkg/msg/Name``. Raises ``TypeConflict``."""
    reader = reader_of(keeper.node, topic, type)
    made = RawSubscription(reader, take, on_links)
    if not reader.registered:
        await keeper.register(reader)
    return made
