"""Publishers of topics that have a gate: what is published through the hub passes it first, whoever publishes."""

from __future__ import annotations

from typing import Protocol

from ropeway.graph.base import Publisher, Sample
from ropeway.hub.topics import TopicUser, ViewPublisher

__all__ = ["Gate", "GatedPublisher"]


class Gate(Protocol):
    """Decides what may be published on a topic."""

    def admit(self, sample: Sample, driver: str) -> Sample | None:
        """Return the message as it may be published by a user of the hub, ``None`` if it may not."""
        ...


class GatedPublisher(ViewPublisher):
    """A topic published through a view, behind a gate."""

    def __init__(self, view: TopicUser, inner: Publisher, gate: Gate, user: str) -> None:
        super().__init__(view, inner)
        self._gate, self._user = gate, user

    def publish(self, sample: Sample) -> None:
        """Send what the gate admits."""
        admitted = self._gate.admit(sample, self._user)
        if admitted is not None:
            super().publish(admitted)
