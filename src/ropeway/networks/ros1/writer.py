"""Topics that we publish: one ROS 1 publication per topic, which all our publishers of it share."""

from __future__ import annotations

import logging
import struct
import time
from collections import deque
from collections.abc import Sequence
from typing import TYPE_CHECKING, Final

from ropeway import aio
from ropeway.errors import DecodeError, TypeConflict
from ropeway.graph.base import SEQ_NONE, Sample, Undelivered, new_origin
from ropeway.graph.history import History
from ropeway.graph.host import Host
from ropeway.graph.parts import PublisherBase
from ropeway.networks.ros1.tcpros import TRACE, TRACE_BYTES, TcprosConnection
from ropeway.qos import QoS
from ropeway.types.ros1_convert import Converter
from ropeway.types.ros1_types import ANY, Ros1Type

if TYPE_CHECKING:
    from ropeway.networks.ros1.node import Ros1Node

__all__ = ["QUEUE_LIMIT_BYTES", "RawPublisher", "Ros1Publisher", "TopicWriter", "writer_of"]

log = logging.getLogger("ropeway.ros1")

QUEUE_LIMIT_BYTES: Final = 64 << 20
"""How much may wait for one subscriber that does not read; the oldest goes first, one message always stays."""

_FLUSH_S: Final = 1.0  # how long what was published last has to reach a subscriber when the topic is withdrawn

_HEAD: Final = struct.Struct("<I")

Frame = tuple[bytes | memoryview, ...]


class _Link:
    """A subscriber's connection, with what waits for it."""

    def __init__(self, writer: TopicWriter, connection: TcprosConnection, *, traced: bool) -> None:
        self.connection, self.traced = connection, traced
        self._writer = writer
        self._waiting: deque[tuple[Frame, int]] = deque()
        self._waiting_bytes = 0

    def put(self, frame: Frame, size: int, depth: int) -> None:
        """Send a message, or have it wait; ``depth`` is how many may wait, 0 for any number."""
        if self.connection.ready and not self._waiting:
            self.connection.write(frame)
            return
        waiting = self._waiting
        waiting.append((frame, size))
        self._waiting_bytes += size
        while len(waiting) > 1 and (self._waiting_bytes > QUEUE_LIMIT_BYTES or (depth and len(waiting) > depth)):
            self._waiting_bytes -= waiting.popleft()[1]
            self._writer.dropped()

    def made(self, connection: TcprosConnection) -> None:
        """See ``tcpros.Receiver``."""

    def header(self, connection: TcprosConnection, fields: dict[str, str]) -> None:
        """See ``tcpros.Receiver``."""

    def frames(self, connection: TcprosConnection, frames: Sequence[bytes]) -> None:
        """Ignore frames: a subscriber has nothing to say; see ``tcpros.Receiver``."""

    def writable(self, connection: TcprosConnection) -> None:
        """See ``tcpros.Receiver``."""
        while self._waiting and connection.ready:
            frame, size = self._waiting.popleft()
            self._waiting_bytes -= size
            connection.write(frame)

    def lost(self, connection: TcprosConnection) -> None:
        """See ``tcpros.Receiver``."""
        self._waiting.clear()
        self._writer.left(self)

    def finish(self) -> None:
        """Send what waits, then close."""
        while self._waiting:
            self.connection.write(self._waiting.popleft()[0])
        self.connection.close()


class TopicWriter:
    """Publishes a topic for our node. It serves raw ROS 1 messages; ``Ros1Publisher`` makes them from CDR."""

    def __init__(self, node: Ros1Node, topic: str, ros1: Ros1Type) -> None:
        self.topic, self.ros1 = topic, ros1
        self.ros1_name = ros1.name
        self.registered = False
        self.node = node
        self.links: list[_Link] = []
        self.users: list[RawPublisher] = []
        self._seq = 0

    def accept(self, connection: TcprosConnection, fields: dict[str, str]) -> None:
        """Accept the connection of a subscriber."""
        ours, asked, caller = self.ros1, fields.get("md5sum", ""), fields.get("callerid", "")
        type = fields.get("type", ANY)
        if asked not in (ANY, ours.md5) or (type not in (ANY, ours.name) and asked == ANY):
            text = (
                f"Client [{caller}] wants topic {self.topic} to have datatype/md5sum [{type}/{asked}], "
                f"but our version has [{ours.name}/{ours.md5}]. Dropping connection."
            )
            log.warning("%s: %s", self.node.graph.name, text)
            connection.refuse(text)
            return
        traced = fields.get(TRACE) == "1"
        connection.write_header(
            {
                "callerid": self.node.name,
                "latching": "1" if any(user.history is not None for user in self.users) else "0",
                "md5sum": ours.md5,
                "message_definition": ours.text,
                "topic": self.topic,
                "type": ours.name,
                **({TRACE: "1"} if traced else {}),
            }
        )
        link = _Link(self, connection, traced=traced)
        connection.receiver = link
        self.links.append(link)
        for user in self.users:
            for sample in user.history.replay() if user.history is not None else ():
                self._put((link,), sample, user.stamped, 0)
        self._tell()

    def send(self, message: Sample, stamped: bool, depth: int) -> None:
        """Send a message, whose payload is raw, to every subscriber."""
        if self.links:
            self._put(list(self.links), message, stamped, depth)

    def _put(self, links: Sequence[_Link], message: Sample, stamped: bool, depth: int) -> None:
        raw = message.payload
        self._seq = self._seq + 1 & 0xFFFFFFFF
        body: Frame = (self._seq.to_bytes(4, "little"), memoryview(raw)[4:]) if stamped else (raw,)
        plain: Frame = (_HEAD.pack(len(raw)), *body)
        traced: Frame = ()
        for link in links:
            if not link.traced:
                link.put(plain, len(raw), depth)
                continue
            if not traced:
                trace = message.origin + message.seq.to_bytes(8, "little")
                traced = (_HEAD.pack(TRACE_BYTES), trace, *plain)
            link.put(traced, len(raw), depth)

    def dropped(self) -> None:
        """Count a message that a subscriber was too slow for."""
        self.node.graph.drops[self.topic, Undelivered.WRITE] += 1

    def left(self, link: _Link) -> None:
        """Remove a subscriber that has gone."""
        if link in self.links:
            self.links.remove(link)
            self._tell()

    def _tell(self) -> None:
        for user in self.users:
            user.set_subscribers(len(self.links))

    async def finish(self) -> None:
        """Send what waits, then close all connections; a subscriber that does not read is cut off."""
        links = list(self.links)
        for link in links:
            link.finish()
        try:
            async with aio.timeout(_FLUSH_S):
                for link in links:
                    await link.connection.closed.wait()
        except TimeoutError:
            for link in links:
                link.connection.abort()


class RawPublisher(PublisherBase[Host]):
    """A user of a ``TopicWriter``, who publishes messages as ROS 1 serialises them.

    ``stamped``: the message begins with a header, whose ``seq`` is counted up.
    """

    def __init__(self, writer: TopicWriter, type: str, qos: QoS, *, stamped: bool) -> None:
        super().__init__(writer.node.graph, writer.topic, type, qos)
        self.writer, self.stamped = writer, stamped
        self.history = History(qos) if qos.transient_local else None
        self._subscribers = len(writer.links)
        self._origin, self._last = new_origin(), 0
        self._depth = 0 if qos.history == "keep_all" else qos.depth
        writer.users.append(self)

    def publish_raw(self, raw: bytes, origin: bytes = b"", seq: int = SEQ_NONE) -> None:
        """Send a message; keep it where the topic is latched. Without ``seq`` it is ours."""
        now = time.time_ns()
        if seq == SEQ_NONE:
            origin, seq = self._origin, max(now, self._last + 1)
            self._last = seq
        message = Sample(raw, "", now, origin, seq)
        if self.history is not None:
            self.history.add(message)
        self.writer.send(message, self.stamped, self._depth)

    async def close(self) -> None:
        """Withdraw the topic."""
        if self.closed:
            return
        self.closed = True
        self.writer.users.remove(self)
        await _leave(self.writer)


class Ros1Publisher(RawPublisher):
    """A topic published on a ``Ros1Graph``: see ``ropeway.graph.base.Publisher``."""

    def __init__(self, writer: TopicWriter, type: str, qos: QoS, converter: Converter) -> None:
        super().__init__(writer, type, qos, stamped=converter.stamped)
        self._converter = converter
        self._key = ("ros1", type)
        self._blamed = False

    def publish(self, sample: Sample) -> None:
        """Send to every subscriber; what nobody reads and nothing keeps is not even converted."""
        writer = self.writer
        if self.closed:
            writer.node.graph.drops[self.topic, Undelivered.CLOSED] += 1
            return
        if not writer.links and self.history is None:
            return
        try:
            raw: bytes = sample.cached(self._key, lambda: self._converter.to_ros1(sample.payload))
        except DecodeError as error:
            writer.node.graph.drops[self.topic, Undelivered.ENCODE] += 1
            if not self._blamed:
                self._blamed = True
                log.warning("%s: a message of %s cannot be sent: %s", writer.node.graph.name, self.topic, error)
            return
        self.publish_raw(raw, sample.origin, sample.seq)


async def _leave(writer: TopicWriter) -> None:
    """Withdraw a topic when its last user has left."""
    node = writer.node
    if writer.users or node.writers.get(writer.topic) is not writer:
        return
    del node.writers[writer.topic]
    if writer.registered:
        writer.registered = False
        await node.master.leave("unregisterPublisher", writer.topic, node.uri)
    await writer.finish()


def writer_of(node: Ros1Node, topic: str, ros1: Ros1Type) -> TopicWriter:
    """Return the writer of ``topic``, made if there is none. Raises ``TypeConflict`` where it has another type."""
    found = node.writers.get(topic)
    if found is None:
        found = node.writers[topic] = TopicWriter(node, topic, ros1)
    assert isinstance(found, TopicWriter)
    if found.ros1.md5 != ros1.md5:
        raise TypeConflict(topic, found.ros1.name, ros1.name)
    return found
