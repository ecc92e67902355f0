"""Topics that we read: one ROS 1 subscription per topic, with a connection to each publisher."""

from __future__ import annotations

import asyncio
import logging
import time
from collections.abc import Sequence
from itertools import islice
from typing import TYPE_CHECKING, Final, Protocol

from ropeway import aio
from ropeway.errors import ConnectFailed, InvalidFrame, TypeConflict, TypesError
from ropeway.graph.base import Sample, Undelivered
from ropeway.limits import ROS1_PUBLISHERS_PER_TOPIC
from ropeway.networks.ros1.master import MasterRefused, slave_call
from ropeway.networks.ros1.tcpros import TRACE, TRACE_BYTES, TcprosConnection
from ropeway.tasks import background, describe, end
from ropeway.types.definition import canonical_name, short_name
from ropeway.types.ros1_convert import Converter
from ropeway.types.ros1_types import ANY, Ros1Type

if TYPE_CHECKING:
    from ropeway.networks.ros1.node import FirstSeenPublisher, Ros1Node

__all__ = ["Batch", "Consumer", "Publication", "TopicReader", "reader_of"]

log = logging.getLogger("ropeway.ros1")

_CONNECT_S: Final = 5.0
_RETRY_S: Final = 0.1
_RETRY_LIMIT_S: Final = 5.0


class Batch:
    """Messages of one publisher, oldest first: as they came, and as samples for those who want them."""

    def __init__(
        self, reader: TopicReader, link: Publication, raws: Sequence[bytes], traces: Sequence[bytes] = ()
    ) -> None:
        self.link, self.raws = link, raws
        self._reader, self._traces = reader, traces or [b""] * len(raws)
        self._samples: list[Sample] | None = None

    @property
    def samples(self) -> list[Sample]:
        """The messages in CDR; those that are none of their type are counted and left out."""
        if self._samples is None:
            self._samples = self._reader.decode(self.raws, self._traces, self.link.origin)
        return self._samples


class Consumer(Protocol):
    """Reads a topic."""

    def take(self, batch: Batch) -> None:
        """Take messages."""

    def links_changed(self) -> None:
        """React to a publisher that was connected, or whose connection was lost."""


class Publication:
    """The connection to one publisher, made again as long as the master lists it."""

    def __init__(self, reader: TopicReader, uri: str) -> None:
        self.uri = uri
        self.caller = ""
        self.latched = self.traced = False
        self.connected = False
        self.orphan = False
        self.epoch = reader.node.epoch
        self.last: tuple[bytes, bytes] | None = None  # what is latched, and its trace
        self.origin: FirstSeenPublisher
        self._reader = reader
        self._fresh = False
        self._trace = b""  # of the message that comes next
        self._said = ""
        self._retry_s = _RETRY_S
        self._connection: TcprosConnection | None = None
        self._task = background(self._run(), f"publisher of {reader.topic}")

    async def close(self) -> None:
        """Stop reading from the publisher."""
        if self._connection is not None:
            self._connection.abort("closed")
        if self._task is not asyncio.current_task():
            await end(self._task)

    def stop(self) -> asyncio.Task[None]:
        """Begin to close; the task that is given ends soon."""
        if self._connection is not None:
            self._connection.abort("closed")
        self._task.cancel()
        return self._task

    async def _run(self) -> None:
        while True:
            try:
                await self._connect()
            except (MasterRefused, ConnectFailed, OSError, TimeoutError, InvalidFrame) as error:
                self._say(str(error) or "no answer in time")
            except Exception as error:  # whatever a publisher sends, it is asked again
                log.debug("%s: %s from %s", self._reader.node.graph.name, self._reader.topic, self.uri, exc_info=error)
                self._say(f"it cannot be read: {describe(error)}", logging.WARNING)
            if self.orphan:
                self._reader.forget(self)
                return
            await asyncio.sleep(self._retry_s)
            self._retry_s = min(2 * self._retry_s, _RETRY_LIMIT_S)

    async def _connect(self) -> None:
        reader, node = self._reader, self._reader.node
        answer = await slave_call(node.rpc, self.uri, "requestTopic", node.name, reader.topic, [["TCPROS"]])
        match answer:
            case [str(protocol), str(host), int(port), *_] if protocol == "TCPROS" and 0 < port < 65536:
                pass
            case _:
                raise ConnectFailed(self.uri, f"the answer to requestTopic is of no use: {answer!r:.100}")
        connection = self._connection = TcprosConnection(self)
        loop = asyncio.get_running_loop()
        try:
            async with aio.timeout(_CONNECT_S):
                await loop.create_connection(lambda: connection, host, port)
            timer = loop.call_later(_CONNECT_S, self._check_greeted)
            try:
                await connection.closed.wait()
            finally:
                timer.cancel()
        finally:
            connection.abort()
            self._connection = None
        self._say(connection.reason or "the connection was closed")

    def _check_greeted(self) -> None:
        if self._connection is not None and not self.connected:
            self._connection.abort("the publisher sent no header in time")

    def _say(self, text: str, level: int = logging.INFO) -> None:
        if text != self._said:
            self._said = text
            log.log(level, "%s: %s from %s: %s", self._reader.node.graph.name, self._reader.topic, self.uri, text)

    def made(self, connection: TcprosConnection) -> None:
        """See ``tcpros.Receiver``."""
        connection.write_header(self._reader.request())

    def header(self, connection: TcprosConnection, fields: dict[str, str]) -> None:
        """See ``tcpros.Receiver``."""
        reader = self._reader
        self.caller = fields.get("callerid", "")
        if self.caller == reader.node.name:
            raise InvalidFrame("it is published by ourselves")
        try:
            if "error" in fields:
                raise InvalidFrame(fields["error"])
            reader.check(fields)
        except InvalidFrame as error:
            self._say(error.reason, logging.WARNING)
            raise
        self.origin = reader.node.origin(self.caller or self.uri, reader.topic)
        self.latched = fields.get("latching") == "1"
        self.traced = fields.get(TRACE) == "1"
        self._retry_s, self._said = _RETRY_S, ""
        self._fresh, self._trace = True, b""
        self.connected = True
        reader.links_changed()

    def frames(self, connection: TcprosConnection, frames: Sequence[bytes]) -> None:
        """See ``tcpros.Receiver``."""
        raws, traces = self._split(frames) if self.traced else (frames, [b""] * len(frames))
        if not raws:
            return
        if self._fresh:
            self._fresh = False
            if self.latched and (raws[0], traces[0]) == self.last:
                raws, traces = raws[1:], traces[1:]  # connecting again repeats what is latched
        if self.latched and raws:
            self.last = raws[-1], traces[-1]
        if raws:
            self._reader.deliver(Batch(self._reader, self, raws, traces))

    def _split(self, frames: Sequence[bytes]) -> tuple[list[bytes], list[bytes]]:
        """Separate messages from the traces that go before them."""
        raws: list[bytes] = []
        traces: list[bytes] = []
        for frame in frames:
            if self._trace:
                raws.append(frame)
                traces.append(self._trace)
                self._trace = b""
            elif len(frame) == TRACE_BYTES:
                self._trace = frame
            else:
                raise InvalidFrame("a message without its trace")
        return raws, traces

    @property
    def latest(self) -> Batch | None:
        """The message that the publisher has latched, if it has."""
        return None if self.last is None else Batch(self._reader, self, [self.last[0]], [self.last[1]])

    def writable(self, connection: TcprosConnection) -> None:
        """See ``tcpros.Receiver``."""

    def lost(self, connection: TcprosConnection) -> None:
        """See ``tcpros.Receiver``."""
        if self.connected:
            self.connected = False
            self._reader.links_changed()


class TopicReader:
    """Reads a topic for our node. ``type`` is ``pkg/msg/Name``; ``raw`` tells that nobody wants its samples."""

    def __init__(self, node: Ros1Node, topic: str, type: str) -> None:
        self.node, self.topic, self.type = node, topic, canonical_name(type)
        self.ros1_name = short_name(self.type)
        self.registered = False
        self.users: list[Consumer] = []
        self._links: dict[str, Publication] = {}
        self._ending: set[asyncio.Task[None]] = set()
        self._converter: Converter | None = None
        self._blamed = False

    @property
    def links(self) -> list[Publication]:
        """The publishers that are connected now."""
        return [link for link in self._links.values() if link.connected]

    @property
    def uris(self) -> set[str]:
        """The publishers that the master told of."""
        return {uri for uri, link in self._links.items() if not link.orphan}

    # ── the type ───────────────────────────────────────────────────────────────────────────────────────────────

    def _known(self) -> Ros1Type | None:
        try:
            found = self.node.types.message(self.type)
        except TypesError:
            return None
        return found if found.sure else None

    def request(self) -> dict[str, str]:
        """Return our header: any MD5 sum is accepted if the ROS 1 definition is not known for sure."""
        known = self._known()
        fields = {
            "callerid": self.node.name,
            "md5sum": known.md5 if known is not None else ANY,
            "tcp_nodelay": "1",
            "topic": self.topic,
            "type": self.ros1_name,
            TRACE: "1",
        }
        if known is not None:
            fields["message_definition"] = known.text
        return fields

    def check(self, fields: dict[str, str]) -> None:
        """Check that we can read what a publisher offers, and learn its definition. Raises ``InvalidFrame``."""
        md5, known = fields.get("md5sum", ""), self._known()
        if known is not None:
            if md5 not in (known.md5, ANY):
                raise InvalidFrame(f"it has the md5sum {md5} for {known.name}, not {known.md5}")
            return
        try:
            if self.node.types.learn(self.type, md5, fields.get("message_definition", "")):
                self._converter = None
        except TypesError as error:
            raise InvalidFrame(f"its definition of {self.ros1_name} is of no use: {error}") from None

    def decode(self, raws: Sequence[bytes], traces: Sequence[bytes], origin: FirstSeenPublisher) -> list[Sample]:
        """Decode messages to samples; whatever is not of this type is counted and left out."""
        converter = self._converter
        stamp_ns = time.time_ns()
        out: list[Sample] = []
        for raw, trace in zip(raws, traces, strict=True):
            try:
                if converter is None:
                    converter = self._converter = self.node.types.converter(self.type)
                payload = converter.from_ros1(raw)
            except TypesError as error:
                self.node.graph.drops[self.topic, Undelivered.DECODE] += 1
                if not self._blamed:
                    self._blamed = True
                    log.warning("%s: a message of %s is unreadable: %s", self.node.graph.name, self.topic, error)
                continue
            if trace:
                out.append(Sample(payload, self.type, stamp_ns, trace[:16], int.from_bytes(trace[16:], "little")))
            else:
                out.append(Sample(payload, self.type, stamp_ns, origin.id, origin.next(stamp_ns)))
        return out

    # ── publishers ─────────────────────────────────────────────────────────────────────────────────────────────

    def update(self, uris: Sequence[str]) -> None:
        """Take the current list of the topic's publishers.

        A connection made before the master forgot everything lives on, for nobody has told its publisher to stop.
        """
        wanted = dict.fromkeys(uri for uri in uris if uri != self.node.uri)
        if len(wanted) > ROS1_PUBLISHERS_PER_TOPIC:
            kept_first = dict.fromkeys((*(uri for uri in wanted if uri in self._links), *wanted))
            wanted = dict.fromkeys(islice(kept_first, ROS1_PUBLISHERS_PER_TOPIC))
            log.warning("%s: %s has more publishers than are read", self.node.graph.name, self.topic)
        for uri, link in list(self._links.items()):
            if uri in wanted:
                link.orphan, link.epoch = False, self.node.epoch
            elif link.connected and link.epoch < self.node.epoch:
                link.orphan = True
            else:
                del self._links[uri]
                self._end(link)
        for uri in wanted:
            if uri not in self._links:
                self._links[uri] = Publication(self, uri)

    def _end(self, link: Publication) -> None:
        task = link.stop()
        self._ending.add(task)
        task.add_done_callback(self._ending.discard)

    def forget(self, link: Publication) -> None:
        """Forget an orphaned connection that has ended."""
        if self._links.get(link.uri) is link:
            del self._links[link.uri]

    def deliver(self, batch: Batch) -> None:
        """Deliver messages of one publisher."""
        for user in list(self.users):
            user.take(batch)

    def links_changed(self) -> None:
        """Tell the consumers that a publisher was connected, or its connection lost."""
        for user in list(self.users):
            user.links_changed()

    async def leave(self, user: Consumer) -> None:
        """Remove ``user``; when the last one leaves, the topic is unsubscribed."""
        if user in self.users:
            self.users.remove(user)
        node = self.node
        if self.users or node.readers.get(self.topic) is not self:
            return
        del node.readers[self.topic]
        links, self._links = list(self._links.values()), {}
        for link in links:
            await link.close()
        await end(*self._ending)
        if self.registered:
            self.registered = False
            await node.master.leave("unregisterSubscriber", self.topic, node.uri)


def reader_of(node: Ros1Node, topic: str, type: str) -> TopicReader:
    """Return the reader of ``topic``, made if there is none. Raises ``TypeConflict`` where it has another type."""
    found = node.readers.get(topic)
    if found is None:
        found = node.readers[topic] = TopicReader(node, topic, type)
    assert isinstance(found, TopicReader)
    if found.type != canonical_name(type):
        raise TypeConflict(topic, found.type, type)
    return found
