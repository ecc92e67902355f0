"""The readers of one graph: which there are, with which profile, and how many of those a publisher finds are ours."""

from __future__ import annotations

import logging
import time
from collections.abc import Callable
from dataclasses import replace
from typing import TYPE_CHECKING, Final, Protocol, TypeVar

from ropeway.errors import TypesError
from ropeway.graph.base import Undelivered
from ropeway.graph.qos_adoption import AdoptingSubscription, SharedReader, settled
from ropeway.networks.ros2.discovery import Ros2Discovery
from ropeway.networks.ros2.host import Ros2Host
from ropeway.networks.ros2.interfaces import message_class
from ropeway.networks.ros2.origins import Origins
from ropeway.networks.ros2.participant import Ros2Participant
from ropeway.networks.ros2.profiles import reader_profile
from ropeway.networks.ros2.publisher import Ros2Publisher
from ropeway.networks.ros2.reader import SpinnerReader
from ropeway.qos import QoS, common_qos

if TYPE_CHECKING:
    from ropeway.types import TypeRegistry

__all__ = ["Readers", "Ros2Subscription"]

log = logging.getLogger("ropeway.ros2")

# Some middlewares do not tell the depth of a publisher; what is adopted keeps at least this many.
_MIN_ADOPTED_DEPTH: Final = 10
_OWN_S: Final = 0.2

T = TypeVar("T")
Ros2Subscription = AdoptingSubscription[SpinnerReader]


class ReadersHost(Ros2Host, Protocol):
    """The services of a graph for its readers."""

    @property
    def registry(self) -> TypeRegistry:
        """The definitions of types."""
        ...

    def attempt(self, create: Callable[[], T]) -> T:
        """Do something with rclpy. Raises ``GraphUnavailable`` with what it says."""
        ...

    def forget(self, subscription: Ros2Subscription) -> None:
        """Release what belongs to a closed subscription."""
        ...

    def guard(self, topic: str, callback: Callable[[T], None], value: T) -> None:
        """Run a callback that may fail."""
        ...

    def look_soon(self) -> None:
        """See soon what has changed."""
        ...


class Readers:
    """Holds the readers behind the subscriptions of an opened graph."""

    def __init__(
        self, graph: ReadersHost, participant: Ros2Participant, discovery: Ros2Discovery, origins: Origins
    ) -> None:
        self.name, self.drops = graph.name, graph.drops
        self._graph = graph
        self._participant, self._discovery, self._origins = participant, discovery, origins
        self._shared: dict[tuple[str, str, QoS], SharedReader[SpinnerReader]] = {}
        self._types: dict[SharedReader[SpinnerReader], str] = {}
        self._changed_at: dict[str, float] = {}

    def attach(self, subscription: Ros2Subscription, qos: QoS) -> SharedReader[SpinnerReader]:
        """Return a reader for ``subscription``: shared if samples are volatile, its own if history is replayed.

        Raises ``GraphUnavailable``.
        """
        key = (subscription.topic, subscription.type, qos)
        reader = None if qos.transient_local else self._shared.get(key)
        if reader is None:
            reader = self._make(*key)
            if not qos.transient_local:
                self._shared[key] = reader
        reader.subscriptions = (*reader.subscriptions, subscription)
        return reader

    def _make(self, topic: str, type: str, qos: QoS) -> SharedReader[SpinnerReader]:
        participant = self._participant
        cls = message_class(type)
        raw = self._graph.attempt(
            lambda: participant.node.create_subscription(cls, topic, _never, reader_profile(qos), raw=True)
        )
        reader = SharedReader(self, topic, qos)
        reader.raw = SpinnerReader(raw, topic, type, participant.spinner, participant.rcl, self._origins, self._turned)
        reader.raw.deliver = reader.deliver
        self._types[reader] = type
        participant.spinner.add("subscription", raw.handle, reader.raw.take)
        self._note(topic)
        return reader

    async def detach(self, subscription: Ros2Subscription, reader: SharedReader[SpinnerReader]) -> None:
        """Take a subscription off its reader; the last one takes the reader with it."""
        reader.subscriptions = tuple(s for s in reader.subscriptions if s is not subscription)
        if reader.subscriptions:
            return
        key = (reader.topic, subscription.type, reader.qos)
        if self._shared.get(key) is reader:
            del self._shared[key]
        if self._types.pop(reader, None) is None or reader.raw is None:
            return
        reader.raw.closed = True
        if self._participant.node is not None:
            self._participant.spinner.remove(reader.raw.raw.handle)
            self._participant.node.destroy_subscription(reader.raw.raw)
        self._note(reader.topic)

    def forget(self, subscription: Ros2Subscription) -> None:
        """Release what belongs to a closed subscription."""
        self._graph.forget(subscription)

    def guard(self, topic: str, callback: Callable[[T], None], value: T) -> None:
        """Run a callback that may fail."""
        self._graph.guard(topic, callback, value)

    def is_matched(self, subscription: Ros2Subscription, reader: SharedReader[SpinnerReader]) -> bool:
        """Return whether a reader is matched with every publisher that it should read."""
        if reader.raw is None:
            return True
        return reader.raw.matched >= len(self._discovery.all_publishers(subscription.topic, subscription.type))

    def adopted(self, subscription: Ros2Subscription) -> QoS:
        """Return the profile that a subscription should have now."""
        asked = subscription.asked
        if asked is not None and not subscription.adopts:
            return asked
        offered = [end.qos for end in self._discovery.publishers(subscription.topic, subscription.type)]
        qos = common_qos(offered, subscription.qos)
        if asked is not None:
            return settled(asked, qos)
        if qos.history == "keep_last" and not qos.transient_local:
            qos = replace(qos, depth=max(qos.depth, _MIN_ADOPTED_DEPTH))
        return qos

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
            reader.topic == topic and of_type == type and _fits(reader.qos, offer)
            for reader, of_type in self._types.items()
        )
        beside = sum(
            not end.local and self._discovery.is_own(end) and _fits(end.qos, offer)
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


def _fits(ask: QoS, offer: QoS) -> bool:
    return (offer.reliable or not ask.reliable) and (offer.transient_local or not ask.transient_local)


def _never(_: object) -> None:
    """Satisfy rclpy, which asks for a callback; no executor that would call it ever sees our node."""
