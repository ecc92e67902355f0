"""Publishes for one viewer: its channels, each a passage from its link to a publisher on the graph."""

from __future__ import annotations

import time
from collections.abc import Iterator
from typing import TYPE_CHECKING, Any, Final

from ropeway.delivery.passage import Passage
from ropeway.delivery.pipeline import witnessed
from ropeway.errors import InvalidOperation, RopewayError
from ropeway.graph.base import SEQ_NONE, Sample, new_origin, resolve_name
from ropeway.limits import TOPICS_PER_CLIENT
from ropeway.types.told_types import DefinitionTeller
from ropeway.types.untrusted import json_loads

if TYPE_CHECKING:
    from collections.abc import Callable

    from ropeway.hub.topics import ViewPublisher
    from ropeway.networks.foxglove.host import ViewerHost
    from ropeway.networks.foxglove.wire import ChannelOffer, ViewerMessage

__all__ = ["ViewerPublications", "decoder"]

_SCHEMAS: Final = ("ros2msg", "ros1msg")
_HELD_BYTES: Final = 2 << 10  # of one channel: its names, and the place in tables


def decoder(viewer: ViewerHost, type: str, encoding: str) -> Callable[[bytes], bytes]:
    """Return what makes CDR of a body that a viewer sends in this encoding. Raises ``TypesError``, then and now.

    JSON is that of rosbridge; raw bytes are those of ROS 2, or of ROS 1 on a ROS 1 graph.
    """
    codec = viewer.writer.codec(type)
    if encoding == "json":
        return lambda data: codec.from_json(json_loads(data) if data else {})
    if encoding == viewer.writer.encoding:
        return codec.from_raw
    known = viewer.writer.encoding
    raise InvalidOperation("", f"the encoding {encoding[:40]!r} is not known here; known are {known} and json")


class _Publication:
    """A channel of the viewer."""

    def __init__(self, offer: ChannelOffer, type: str, decode: Callable[[bytes], bytes]) -> None:
        self.offer, self.type, self.decode = offer, type, decode
        self.passage = Passage()
        self.publisher: ViewPublisher | None = None
        self.origin = new_origin()


class ViewerPublications:
    """The channels that a viewer publishes on, by its own ids."""

    def __init__(self, viewer: ViewerHost) -> None:
        self._viewer = viewer
        self._channels: dict[int, _Publication] = {}
        self._teller = DefinitionTeller(viewer.writer.registry)

    @property
    def held_bytes(self) -> int:
        """The bytes kept for the viewer's channels."""
        kept = sum(each.publisher.kept_bytes for each in self._channels.values() if each.publisher is not None)
        return kept + _HELD_BYTES * len(self._channels) + self._teller.held_bytes

    def __contains__(self, channel: int) -> bool:
        return channel in self._channels

    async def add(self, offer: ChannelOffer) -> None:
        """Publish on a channel from now on. Raises ``RopewayError``."""
        viewer = self._viewer
        if offer.id in self._channels:
            raise InvalidOperation("advertise", f"channel {offer.id} is that of {self._channels[offer.id].offer.topic}")
        if len(self._channels) >= TOPICS_PER_CLIENT:
            raise InvalidOperation("advertise", f"a viewer publishes {TOPICS_PER_CLIENT} topics at most")
        name = resolve_name(offer.topic)
        viewer.access.check("publish", name)
        if not viewer.settings.takes_topic(name):
            raise InvalidOperation("advertise", f"{name} is not among the topics of client_topic_whitelist")
        registry = viewer.writer.registry
        type = registry.canonical(offer.type)
        if not registry.has(type):
            await viewer.view.learn(type)
        if not registry.has(type) and offer.schema and offer.schema_encoding in _SCHEMAS:
            self._teller.tell(type, offer.schema)
        publication = _Publication(offer, type, decoder(viewer, type, offer.encoding))
        publication.publisher = await viewer.view.create_publisher(name, type)
        publication.passage.steps = witnessed(viewer.access.witness("publish", name))
        publication.passage.sink = publication.publisher.publish
        self._channels[offer.id] = publication

    async def remove(self, channel: int) -> None:
        """Withdraw a channel. Raises ``InvalidOperation``."""
        publication = self._channels.pop(channel, None)
        if publication is None:
            raise InvalidOperation("unadvertise", f"channel {channel} was not advertised")
        await self._close(publication)

    def published(self, message: ViewerMessage) -> None:
        """Publish a message. Raises ``RopewayError``."""
        publication = self._channels.get(message.channel)
        if publication is None:
            raise InvalidOperation("message data", f"channel {message.channel} was not advertised")
        try:
            payload = publication.decode(message.data)
        except RopewayError as error:
            raise InvalidOperation("message data", f"{publication.offer.topic}: {error}") from None
        sample = Sample(payload, publication.type, time.time_ns(), publication.origin, SEQ_NONE)
        publication.passage.pass_on((sample,))

    def topic_of(self, channel: int) -> str:
        """Return the topic of a channel, or what to call an unknown one."""
        publication = self._channels.get(channel)
        return f"channel {channel}" if publication is None else publication.offer.topic

    def tick(self) -> None:
        """Bring the meters up to date."""
        for publication in self._channels.values():
            publication.passage.meter.update()

    def status(self) -> Iterator[dict[str, Any]]:
        """Yield one row per topic."""
        for each in self._channels.values():
            row = {"name": each.offer.topic, "direction": "in", "type": each.type, "encoding": each.offer.encoding}
            yield {**row, **each.passage.status({})}

    async def close(self) -> None:
        """Withdraw all channels."""
        channels, self._channels = self._channels, {}
        for publication in channels.values():
            await self._close(publication)
        self._teller.leave()

    async def _close(self, publication: _Publication) -> None:
        publication.passage.sink = None
        if publication.publisher is not None:
            await publication.publisher.close()
