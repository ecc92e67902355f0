"""Counts the delays of messages that clients publish and read, by topic and over all clients that come and go."""

from __future__ import annotations

from typing import Any

from ropeway.delivery.histogram import Histogram
from ropeway.limits import CLIENT_DELAY_TOPICS

__all__ = ["ClientDelays"]


class ClientDelays:
    """Holds a histogram for each topic and direction; those beyond ``most`` share one, under the name ``""``.

    The meters of all clients count in the same histogram, so that it goes on when one of them leaves, and a message
    costs no more than without.
    """

    def __init__(self, most: int = CLIENT_DELAY_TOPICS) -> None:
        self._most = most
        self._published: dict[str, Histogram] = {}
        self._read: dict[str, Histogram] = {}

    def published(self, topic: str) -> Histogram:
        """Return the histogram of what clients publish of a topic."""
        return self._of(self._published, topic)

    def read(self, topic: str) -> Histogram:
        """Return the histogram of what clients read of a topic."""
        return self._of(self._read, topic)

    def _of(self, known: dict[str, Histogram], topic: str) -> Histogram:
        if topic not in known and len(known) >= self._most:
            topic = ""
        return known.setdefault(topic, Histogram())

    def to_json(self) -> dict[str, Any]:
        """Return the histograms by direction and topic, those without a message left out."""
        return {
            direction: {topic: told for topic, one in known.items() if (told := one.to_json()) is not None}
            for direction, known in (("published", self._published), ("read", self._read))
        }
