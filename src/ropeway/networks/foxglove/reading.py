"""A channel that one viewer reads: a bridge from the topic on the graph to the viewer's link."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from ropeway.delivery.outbox import SMALL_BYTES, Queue
from ropeway.delivery.passage import Passage
from ropeway.networks.foxglove.wire import message_prefix
from ropeway.qos import QoS

if TYPE_CHECKING:
    from ropeway.errors import TypesError
    from ropeway.graph.base import Sample
    from ropeway.hub.topics import ViewSubscription
    from ropeway.networks.foxglove.channels import TopicChannel
    from ropeway.networks.foxglove.host import ViewerHost

__all__ = ["ChannelReader"]

_ROS1: str = "ros1"


class ChannelReader:
    """The subscription ``id`` of a viewer. The topic is read while it is open, and nobody reads it without."""

    def __init__(self, viewer: ViewerHost, id: int, channel: TopicChannel) -> None:
        self.id, self.channel = id, channel
        self.prefix = message_prefix(id)
        self._viewer = viewer
        self._codec = viewer.writer.codec(channel.type) if viewer.writer.encoding == _ROS1 else None
        self._queue: Queue[Sample] = viewer.sender.outbox.open(Queue(self))
        self._queue.ready_bytes = SMALL_BYTES
        self.passage = Passage(delays=viewer.view.hub.client_delays.read(channel.topic), sink=self._put)
        self._subscription: ViewSubscription | None = None

    async def open(self) -> None:
        """Read the topic. Raises what the graph raises."""
        channel, settings = self.channel, self._viewer.settings
        asked = None
        if settings.reads_best_effort(channel.topic):
            asked = QoS(reliability="best_effort", depth=settings.max_depth)
        self._subscription = await self._viewer.view.create_subscription(
            channel.topic, channel.type, asked, self.passage.pass_on
        )
        self._subscription.on_qos(self._follow)

    def _follow(self, qos: QoS) -> None:
        """Let as many messages wait as the profile keeps; of a camera only the newest does, as it is large."""
        self._queue.depth = self._viewer.settings.depth(qos.depth)
        self._queue.latched = qos.latched

    def _put(self, sample: Sample) -> None:
        self._viewer.sender.put(self._queue, sample)

    def body(self, sample: Sample) -> bytes:
        """See ``ViewerStream.body``; a message of ROS 1 is written once, however many viewers read it."""
        codec = self._codec
        if codec is None:
            return sample.payload
        made: bytes = sample.cached(_ROS1, lambda: codec.raw(sample.payload))
        return made

    def unreadable(self, error: TypesError) -> None:
        """See ``ViewerStream.unreadable``."""
        self._viewer.fault_log.note("message", self.channel.topic, error)

    def status(self) -> dict[str, Any]:
        """Return the row of the topic in the status of the viewer."""
        row = {"name": self.channel.topic, "direction": "out", "type": self.channel.type}
        return {**row, "encoding": self._viewer.writer.encoding, **self.passage.status(self._queue.lost)}

    async def close(self) -> None:
        """Stop reading."""
        self.passage.sink = None
        self._viewer.sender.outbox.close(self._queue)
        if self._subscription is not None:
            await self._subscription.close()
            self._subscription = None
