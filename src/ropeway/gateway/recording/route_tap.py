"""Gives a recorder what has crossed a route, with the QoS with which it was published on the other side."""

from __future__ import annotations

import time
from collections.abc import Callable

from ropeway.gateway.config.config import Route
from ropeway.graph.base import Publisher, Sample
from ropeway.listener.http import without_token
from ropeway.recording.channel import Recorded, RecordingChannel, cdr_channel
from ropeway.types import TypeRegistry

__all__ = ["RouteTap"]


class RouteTap:
    """Makes a recorded message of each sample, for all recorders that want the route.

    Its time is that at which it crossed. ``publisher`` finds the side that it goes to, which may come later and change.
    """

    __slots__ = ("_channel", "_publisher", "_qos", "_registry", "_route", "_sinks")

    def __init__(
        self,
        route: Route,
        registry: TypeRegistry,
        publisher: Callable[[], Publisher | None],
        sinks: tuple[Callable[[Recorded], None], ...],
    ) -> None:
        self._route, self._registry, self._publisher, self._sinks = route, registry, publisher, sinks
        self._channel: RecordingChannel | None = None
        self._qos: object = None

    def __call__(self, sample: Sample) -> None:
        """Take a message that has crossed."""
        publisher = self._publisher()
        channel = self._channel
        if channel is None or (publisher is not None and publisher.qos is not self._qos):
            channel = self._begin(publisher)
        message = Recorded(channel, time.time_ns(), sample.payload)
        for sink in self._sinks:
            sink(message)

    def _begin(self, publisher: Publisher | None) -> RecordingChannel:
        """Make the channel, or another where the QoS has changed."""
        route, offered = self._route, [] if publisher is None else [publisher.qos]
        self._qos = None if publisher is None else publisher.qos
        made = cdr_channel(self._registry, route.name, route.type, offered)
        made.metadata.update(
            route=f"{route.operation} {route.name}",
            remote=without_token(route.remote.address),
            remote_name=route.remote_name,
        )
        self._channel = made
        return made
