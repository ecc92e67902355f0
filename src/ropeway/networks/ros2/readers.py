"""The readers of one graph: which there are, with which profile, and how many of those a publisher finds are ours."""

from __future__ import annotations

import logging
import time
from collections.abc import Callable
from typing import TYPE_CHECKING, Final, Protocol, TypeVar

from ropeway.errors import TypesError
from ropeway.graph.base import Undelivered
from ropeway.graph.qos_adoption import AdoptingSubscription, Readers, SharedReader
from ropeway.networks.ros2.discovery import Ros2Discovery
from ropeway.networks.ros2.host import Ros2Host
from ropeway.networks.ros2.interfaces import message_class
from ropeway.networks.ros2.origins import Origins
from ropeway.networks.ros2.participant import Ros2Participant
from ropeway.networks.ros2.profiles import reader_profile
from ropeway.networks.ros2.publisher import Ros2Publisher
from ropeway.networks.ros2.reader import SpinnerReader
from ropeway.qos import QoS

if TYPE_CHECKING:
    from ropeway.types import TypeRegistry

__all__ = ["Ros2Readers", "Ros2Subscription"]

log = logging.getLogger("ropeway.ros2")

_OWN_S: Final = 0.2

T = TypeVar("T")
Ros2Subscription = AdoptingSubscription[SpinnerReader]


class Ros2ReadersHost(Ros2Host, Protocol):
    """The services of a graph for its readers."""

    @property
    def registry(self) -> TypeRegistry:
        """The definitions of types."""
        ...

    def attempt(self, create: Callable[[], T]) -> T:
        """Do something with rclpy. Raises ``GraphUnavailable`` with what it says."""
        ...

    def look_soon(self) -> None:
        """See soon what has changed."""
        ...


class Ros2Readers(Readers[SpinnerReader]):
    """Holds the readers behind the subscriptions of an opened graph."""

    def __init__(
        self, graph: Ros2ReadersHost, participant: Ros2Participant, discovery: Ros2Discovery, origins: Origins
    ) -> None:
        super().__init__(graph)
        self._graph = graph
        self._participant, self._discovery, self._origins = participant, discovery, origins
        self._readers: dict[SpinnerReader, SharedReader[SpinnerReader]] = {}
        self._changed_at: dict[str, float] = {}

    def _make(self, reader: SharedReader[SpinnerReader]) -> SpinnerReader:
        participant, topic = self._participant, reader.topic
        cls, profile = message_class(reader.type), reader_profile(reader.qos)
        raw = self._graph.attempt(lambda: participant.node.create_subscription(cls, topic, _never, profile, raw=True))
        made = SpinnerReader(raw, topic, reader.type, participant.spinner, participant.rcl, self._origins, self._turned)
        made.deliver = reader.deliver
        self._readers[made] = reader
        participant.spinner.add("subscription", raw.handle, made.take)
        self._note(topic)
        return made

    async def _delete(self, raw: SpinnerReader) -> None:
        reader = self._readers.pop(raw)
        raw.closed = True
        if self._participant.node is not None:
            self._participant.spinner.remove(raw.raw.handle)
            self._participant.node.destroy_subscription(raw.raw)
        self._note(reader.topic)

    def is_matched(self, reader: SharedReader[SpinnerReader]) -> bool:
        """See ``Readers``."""
        return reader.raw is None or reader.raw.matched >= len(
            self._discovery.all_publishers(reader.topic, reader.type)
        )

    def offered(self, topic: str, type: str) -> list[QoS]:
        """See ``Readers``."""
        return [end.qos for end in self._discovery.publishers(topic, type)]

    def count_others(self, publisher: Ros2Publisher) -> int:
        """Return how many readers of others are matched with a publisher.

        A moment after a reader of our own has come or gone it may be matched or not: the count stays as it was.
        """
        topic, type, offer = publisher.topic, publisher.type, publisher.qos
        if time.monotonic() - self._changed_at.get(topic, -_OWN_S) < _OWN_S:
            return publisher.counted
        try:
            matched = int(publisher.raw.get_subscription_count())
        except RuntimeError:  # it was destroyed, or the middleware has failed
            return 0
        here = sum(
            reader.topic == topic and reader.type == type and offer.satisfies(reader.qos)
            for reader in self._readers.values()
        )
        beside = sum(
            not end.local and self._discovery.is_own(end) and offer.satisfies(end.qos)
            for end in self._discovery.subscriptions(topic, type)
        )
        return max(matched - here - beside, 0)

    def _note(self, topic: str) -> None:
        self._changed_at[topic] = time.monotonic()
        self._graph.look_soon()

    def _turned(self, topic: str, type: str, payload: bytes) -> bytes | None:
        """Convert a message of a big-endian machine to little-endian."""
        try:
            codec = self._graph.registry.codec(type)
            return codec.encode(codec.decode(payload))
        except TypesError as error:
            self.drops[topic, Undelivered.DECODE] += 1
            log.debug("%s: %s: a message cannot be read: %s", self.name, topic, error)
            return None


def _never(_: object) -> None:
    """Satisfy rclpy, which asks for a callback; no executor that would call it ever sees our node."""
