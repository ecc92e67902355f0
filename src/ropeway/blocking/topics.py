"""Publishers and subscriptions for threads."""

from __future__ import annotations

from collections.abc import Iterator
from typing import TypeVar

from ropeway.api.message import TypedMessage
from ropeway.api.topics import AsyncPublisher, AsyncSubscription
from ropeway.blocking.part import BlockingPart
from ropeway.blocking.portal import portal
from ropeway.errors import GraphUnavailable
from ropeway.graph.calls import DEFAULT_TIMEOUT_S
from ropeway.qos import QoS

__all__ = ["BlockingPublisher", "BlockingSubscription"]


_Topic = TypeVar("_Topic", bound=AsyncPublisher | AsyncSubscription)


class _TopicPart(BlockingPart[_Topic]):
    """A topic that a program publishes or reads."""

    @property
    def topic(self) -> str:
        """Return the name of the topic."""
        return self._inner.topic

    @property
    def type(self) -> str:
        """Return its type, such as ``std_msgs/msg/String``."""
        return self._inner.type

    @property
    def qos(self) -> QoS:
        """Return the profile in use: as asked, or else what the publishers of a topic that is read offer."""
        return self._inner.qos


class BlockingPublisher(_TopicPart[AsyncPublisher]):
    """A topic that a program publishes; ``BlockingGraph.publisher`` makes it."""

    @property
    def subscribers(self) -> int | None:
        """Return how many read the topic now, ``None`` where the network cannot tell."""
        return self._inner.subscribers

    def publish(self, message: object) -> None:
        """Publish a message; see ``AsyncPublisher.publish``. Does not wait for the network."""
        portal.call(lambda: self._inner.publish(message))

    def wait_for_subscribers(self, count: int = 1, *, timeout_s: float | None = DEFAULT_TIMEOUT_S) -> None:
        """Wait until ``count`` subscriptions read the topic. Raises ``WaitTimeout``."""
        portal.run(lambda: self._inner.wait_for_subscribers(count, timeout_s=timeout_s), None)


class BlockingSubscription(_TopicPart[AsyncSubscription]):
    """A topic that a program reads; ``BlockingGraph.subscribe`` makes it.

    A loop over it gives each message, and waits for the next until somebody closes the subscription.
    """

    @property
    def dropped(self) -> int:
        """Return how many messages were dropped because the program did not take them in time."""
        return self._inner.dropped

    @property
    def failures(self) -> int:
        """Return how often the callback has failed."""
        return self._inner.failures

    def receive(self, *, timeout_s: float | None = DEFAULT_TIMEOUT_S) -> TypedMessage:
        """Return the next message. Raises ``WaitTimeout``; ``None`` waits for ever."""
        return portal.run(lambda: self._inner.receive(timeout_s=timeout_s), None)

    def __iter__(self) -> Iterator[TypedMessage]:
        while (message := self._next()) is not None:
            yield message

    def _next(self) -> TypedMessage | None:
        try:
            return self.receive(timeout_s=None)
        except GraphUnavailable:
            return None
