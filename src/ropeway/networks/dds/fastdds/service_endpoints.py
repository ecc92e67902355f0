"""Clients and services in the mapping of Fast DDS, as the helper process has them: a reader and a writer each.

Two threads come here, one at a time: whoever is at work holds the lock of the ``FastNode``.
"""

from __future__ import annotations

import ctypes as ct
import struct
import time
from collections import deque
from collections.abc import Callable
from typing import Any, Final, Protocol

from ropeway.graph.base import Undelivered
from ropeway.networks.dds import raw
from ropeway.networks.dds.endpoint_qos import reader_qos, writer_qos
from ropeway.networks.dds.fastdds import serdata_hook as hook
from ropeway.networks.dds.fastdds.early_reader import take_early
from ropeway.networks.dds.fastdds.frames import MAX_BODY_BYTES, HelperFrame, Op, Spec
from ropeway.networks.dds.fastdds.identity import (
    NOBODY,
    PID_RELATED,
    PREFIX_BYTES,
    UNKNOWN_SEQ,
    SampleIdentity,
    SampleOrigin,
    is_reader,
)
from ropeway.networks.dds.fastdds.serdata_hook import RelatedWriter
from ropeway.networks.dds.names import dds_service_topics, dds_type
from ropeway.networks.dds.raw import INFO, SampleInfo, check, lib, matched
from ropeway.networks.dds.raw_endpoints import without_padding
from ropeway.networks.dds.selftest import choose_layout
from ropeway.qos import QoS

__all__ = ["ClientEnd", "ServiceEnd"]

_READ_QOS: Final = QoS(history="keep_all")
_WRITE_QOS: Final = QoS(depth=512)  # what a reader that hangs can make us keep
_BATCH: Final = 64
_PENDING_LIMIT: Final = 4096
_SETTLE_S: Final = 0.1
_PRIMING_S: Final = 1.0
_PATIENCE_S: Final = 2.0
_MATCH_S: Final = 1.0  # how long an answer waits until its reader is matched
_request_head = struct.Struct("<16sq")


class EndpointHost(Protocol):
    """The services of a node for its endpoints."""

    participant: int
    emit: Callable[[HelperFrame], None]

    def mark_of(self, type_hash: str) -> bytes:
        """Return the USER_DATA of an endpoint whose messages have this hash."""
        ...

    def attach(self, number: int, reader: int, writer: int) -> None:
        """Wait for the data and the matches of an endpoint, too."""
        ...

    def hears(self, vendor: bytes) -> bool:
        """Return whether a vendor speaks this mapping."""
        ...

    def count(self, number: int, reason: Undelivered) -> None:
        """Count a request or reply that was lost, and why."""
        ...

    def wake(self) -> None:
        """Wake the thread."""
        ...


class _End:
    """A reader and a writer on the topics of one service."""

    def __init__(self, node: EndpointHost, number: int, spec: Spec, *, serves: bool) -> None:
        self.number = number
        self.node = node
        self._refs = (ct.c_uint64 * _BATCH)()
        self._infos = (SampleInfo * _BATCH)()
        self._raw = memoryview(self._infos).cast("B")
        self._writers: dict[int, bytes] = {}
        self.readers: set[bytes] = set()
        self.matched: dict[bytes, float] = {}  # who writes to us and reads us, by the prefix of GUIDs, and since when
        self._primers: list[int] = []
        self._primed_at = 0.0
        request, reply = dds_service_topics(spec.service)
        ask = (request, dds_type(spec.type, "_Request"), node.mark_of(spec.request_hash))
        answer = (reply, dds_type(spec.type, "_Response"), node.mark_of(spec.response_hash))
        self._entities: list[int] = []
        try:
            # The reader is told first: who gets a request of ours should know already who waits for the reply.
            self._reads, self._writes = (ask, answer) if serves else (answer, ask)
            self._reader = self._make(self._reads, self._entities, writes=False)
            self.reader_guid = raw.guid_of(self._reader)
            if serves:  # a reader of replies could wait for those to others, which nobody tells it to do without
                take_early(self._reader, self._sertype)
            self._entity = self._make(self._writes, self._entities, writes=True)
            self.writer = RelatedWriter(self._entity, self._sertype)
            node.attach(number, self._reader, self._entity)
        except BaseException:
            self.close()
            raise

    def _make(self, what: tuple[str, str, bytes], entities: list[int], *, writes: bool) -> int:
        """Make a reader or writer with a topic of its own; both are added to ``entities``."""
        topic, type, mark = what
        entity, sertype = raw.create_topic(self.node.participant, topic, type)
        entities.append(entity)
        choose_layout("dds", sertype)
        hook.install(sertype, type)
        self._sertype = sertype
        if writes:
            with writer_qos(_WRITE_QOS, mark) as qos:
                made = check(lib.create_writer(self.node.participant, entity, qos, None), f"create writer {topic}")
        else:
            with reader_qos(_READ_QOS, mark) as qos:
                made = check(lib.create_reader(self.node.participant, entity, qos, None), f"create reader {topic}")
        entities.append(made)
        return made

    def close(self) -> None:
        """Leave the network."""
        self._end_priming()
        for entity in reversed(self._entities):
            lib.delete(entity)
        self._entities.clear()

    def _prime(self) -> None:
        """Have writers that we have just found tell where they are in their numbers, by a reader that is news to them.

        Fast DDS tells each reader so once, when it finds it. If it found ours before we found its writer, that was in
        vain; Cyclone DDS then takes the first that it is told with a sample, and that sample for one of the past.
        Nodes count readers and writers of a service, so there comes one of each.
        """
        self._end_priming()
        self._primed_at = time.monotonic()
        self._make(self._reads, self._primers, writes=False)
        self._make(self._writes, self._primers, writes=True)

    def _end_priming(self) -> None:
        for entity in reversed(self._primers):
            lib.delete(entity)
        self._primers.clear()

    def on_data(self) -> None:
        """Take what is there."""
        while True:
            count = check(lib.takecdr(self._reader, self._refs, _BATCH, self._infos, raw.ANY_STATE), "takecdr")
            for serdata, (_, valid, _, _, handle) in zip(
                self._refs[:count], INFO.iter_unpack(self._raw[: count * INFO.size]), strict=True
            ):
                try:
                    if valid:
                        self._take(serdata, handle)
                finally:
                    lib.serdata_unref(serdata)
            if count < _BATCH:
                return

    def _take(self, serdata: int, handle: int) -> None:
        origin = hook.origin_of(serdata)
        if origin is None or origin.identity.guid != (self._writer_of(handle) or origin.identity.guid):
            self.node.count(self.number, Undelivered.DECODE)
            return
        if not self.node.hears(origin.vendor):
            return
        size = lib.serdata_size(serdata)
        if size > MAX_BODY_BYTES // 2:
            self.node.count(self.number, Undelivered.BACKLOG)
            return
        payload = without_padding(ct.string_at(serdata + lib.header_at, size))
        self.on_sample(origin, origin.encoding + payload[2:])

    def _writer_of(self, handle: int) -> bytes:
        """Return the GUID of a writer according to discovery, for comparison; ``b""`` if it has left already."""
        guid = self._writers.get(handle)
        if guid is None:
            guid = _guid(lib.get_matched_publication_data(self._reader, handle))
            if guid:
                self._writers[handle] = guid
        return guid

    def on_sample(self, origin: SampleOrigin, payload: bytes) -> None:
        """Handle a request or a reply."""
        raise NotImplementedError

    def on_matches(self) -> set[bytes]:
        """Take note of who is there; gives those who have left, by the prefix of their GUIDs."""
        status = ct.c_uint32()
        check(lib.take_status(self._reader, ct.byref(status), raw.SUBSCRIPTION_MATCHED), "take_status")
        check(lib.take_status(self._entity, ct.byref(status), raw.PUBLICATION_MATCHED), "take_status")
        handles = matched(lib.get_matched_publications, self._reader)
        self._writers = {handle: guid for handle in handles if (guid := self._writer_of(handle))}
        handles = matched(lib.get_matched_subscriptions, self._entity)
        self.readers = {_guid(lib.get_matched_subscription_data(self._entity, handle)) for handle in handles}
        writers = {guid[:PREFIX_BYTES] for guid in self._writers.values()}
        readers = {guid[:PREFIX_BYTES] for guid in self.readers}
        now = time.monotonic()
        found = {prefix: self.matched.get(prefix, now) for prefix in writers & readers if self.node.hears(prefix[:2])}
        gone = self.matched.keys() - found.keys()
        if found.keys() - self.matched.keys():
            self._prime()
        self.matched = found
        self.tick()
        return gone

    @property
    def waits(self) -> bool:
        """Whether ``tick`` has to be called now and then."""
        return bool(self._primers)

    def tick(self) -> None:
        """Do what has its time."""
        if self._primers and time.monotonic() - self._primed_at > _PRIMING_S:
            self._end_priming()

    def _write(self, payload: bytes, parameter: int, related: SampleIdentity) -> int:
        seq = self.writer.write(payload, parameter, related, time.time_ns())
        lib.write_flush(self._entity)
        return seq


class ClientEnd(_End):
    """Calls a service. ``emit`` tells how many serve it, and what becomes of each call."""

    def __init__(self, node: EndpointHost, number: int, spec: Spec) -> None:
        self._calls: dict[int, tuple[int, set[bytes]]] = {}
        self._numbers: dict[int, int] = {}
        self.last = 0  # the number of the latest request on the network
        self._ready = 0
        super().__init__(node, number, spec, serves=False)

    def call(self, number: int, payload: bytes, parameter: int = PID_RELATED) -> None:
        """Send a request."""
        if len(self._calls) >= _PENDING_LIMIT:
            self._tell(Op.FAILED, number, "too many calls are under way")
            return
        try:
            seq = self._write(payload, parameter, SampleIdentity(self.reader_guid, UNKNOWN_SEQ))
        except raw.DdsError as error:
            self._tell(Op.FAILED, number, f"the request cannot be sent: {error}")
            return
        self.last = seq
        self._calls[seq] = (number, set(self.matched))
        self._numbers[number] = seq

    def forget(self, number: int) -> None:
        """Forget a call that nobody waits for any more."""
        self._calls.pop(self._numbers.pop(number, 0), None)

    def on_sample(self, origin: SampleOrigin, payload: bytes) -> None:
        """Pass a reply on if it is one of ours."""
        related = origin.related
        if related is None or related.guid not in (self.reader_guid, self.writer.guid):
            return
        found = self._calls.pop(related.seq, None)
        if found is None:
            self.node.count(self.number, Undelivered.LATE)
            return
        del self._numbers[found[0]]
        self.node.emit(HelperFrame(Op.RESPONSE, self.number, found[0], payload))

    def on_matches(self) -> set[bytes]:
        """Take note of who serves it, and give up the calls whose servers have left."""
        gone = super().on_matches()
        if gone:
            self.on_data()  # an answer may have come before its server left
            for seq, (number, asked) in list(self._calls.items()):
                asked -= gone
                if not asked:
                    del self._calls[seq], self._numbers[number]
                    self._tell(Op.LOST, number, "its server has left")
        return gone

    @property
    def waits(self) -> bool:
        """Whether there are servers that are matched and not yet ready."""
        return super().waits or self._ready < len(self.matched)

    def tick(self) -> None:
        """Tell how many servers are ready.

        They are when the server knows our writer, and it has had the time to tell our reader where its replies begin:
        Cyclone DDS takes what comes before that for replies to others.
        """
        super().tick()
        now = time.monotonic()
        heard = self.writer.acks > 0
        ready = sum(now - since > (_SETTLE_S if heard else _PATIENCE_S) for since in self.matched.values())
        if ready != self._ready:
            self._ready = ready
            self.node.emit(HelperFrame(Op.MATCHED, self.number, ready))

    def _tell(self, op: Op, number: int, text: str) -> None:
        self.node.emit(HelperFrame(op, self.number, number, text.encode()))


class ServiceEnd(_End):
    """Serves a service. ``emit`` passes each request on, under a number that its answer is to carry."""

    def __init__(self, node: EndpointHost, number: int, spec: Spec) -> None:
        self._requests: dict[int, tuple[int, SampleIdentity]] = {}
        self._last = 0
        self._clients = 0
        self._waiting: deque[tuple[float, int, SampleIdentity, bytes]] = deque()
        super().__init__(node, number, spec, serves=True)
        self._make(self._writes, self._entities, writes=True)  # what makes up for ``FastHelper``'s weight

    def on_sample(self, origin: SampleOrigin, payload: bytes) -> None:
        """Pass a request on."""
        if len(self._requests) >= _PENDING_LIMIT:
            self.node.count(self.number, Undelivered.BACKLOG)
            return
        asks = origin.related.guid if origin.related is not None else NOBODY
        identity = origin.identity if asks == NOBODY else SampleIdentity(asks, origin.identity.seq)
        self._last += 1
        self._requests[self._last] = (origin.parameter or PID_RELATED, identity)
        head = _request_head.pack(*origin.identity)
        self.node.emit(HelperFrame(Op.REQUEST, self.number, self._last, head + payload))

    def asked(self, number: int) -> tuple[int, SampleIdentity] | None:
        """Return the parameter and the related identity with which a request is to be answered."""
        return self._requests.get(number)

    def reply(self, number: int, payload: bytes) -> None:
        """Answer a request, as soon as who asked can hear it."""
        parameter, identity = self._requests.pop(number, (0, None))
        if identity is None:
            return
        if not self._can_hear(identity.guid):
            self._waiting.append((time.monotonic() + _MATCH_S, parameter, identity, payload))
            self.node.wake()
        else:
            self._send(parameter, identity, payload)

    def forget(self, number: int) -> None:
        """Leave a request unanswered."""
        self._requests.pop(number, None)

    @property
    def waits(self) -> bool:
        """Whether answers wait for their readers."""
        return super().waits or bool(self._waiting)

    def tick(self) -> None:
        """Tell how many clients there are; send the answers whose readers have come, give up those whose do not."""
        super().tick()
        if len(self.matched) != self._clients:
            self._clients = len(self.matched)
            self.node.emit(HelperFrame(Op.MATCHED, self.number, self._clients))
        now = time.monotonic()
        for _ in range(len(self._waiting)):
            until, parameter, identity, payload = self._waiting.popleft()
            if self._can_hear(identity.guid):
                self._send(parameter, identity, payload)
            elif now < until:
                self._waiting.append((until, parameter, identity, payload))
            else:
                self.node.count(self.number, Undelivered.LATE)

    def _can_hear(self, guid: bytes) -> bool:
        """Return whether ``guid`` reads our answers, or is a writer, whose reader is not known."""
        return guid in self.readers or not is_reader(guid)

    def _send(self, parameter: int, identity: SampleIdentity, payload: bytes) -> None:
        try:
            self._write(payload, parameter, identity)
        except raw.DdsError:
            self.node.count(self.number, Undelivered.WRITE)


def _guid(data: Any) -> bytes:
    """Return the GUID in discovery data of an endpoint, and free the data; ``b""`` for nothing."""
    if not data:
        return b""
    try:
        return bytes(data.contents.key)
    finally:
        lib.builtintopic_free_endpoint(data)
