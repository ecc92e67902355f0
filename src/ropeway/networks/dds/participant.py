"""A participant of a DDS domain that looks like a ROS 2 node: entities, what is discovered, and the node's own record.

Everything a graph needs of DDS goes through here: ``create_reader`` and ``create_writer`` work on any topic and type,
so that topics, services and actions share them.
"""

from __future__ import annotations

import asyncio
import contextlib
import ctypes as ct
import logging
from collections import deque
from collections.abc import Callable, Iterator
from typing import Final

from ropeway.graph.base import Sample, Undelivered
from ropeway.networks.dds import domain, raw
from ropeway.networks.dds.byteorder import ByteOrder
from ropeway.networks.dds.endpoint_qos import parse_user_data, read_qos, reader_qos, user_data, writer_qos
from ropeway.networks.dds.matching import Matches, since_of
from ropeway.networks.dds.names import DISCOVERY_TOPIC, DISCOVERY_TYPE, DISCOVERY_TYPE_HASH
from ropeway.networks.dds.nodes import GID_BYTES, OLD_GID_BYTES, NodeEntities, ParticipantEntities, encode, parse
from ropeway.networks.dds.profile import Profile
from ropeway.networks.dds.raw import ALIVE, INFO, BuiltinEndpoint, ParticipantData, SampleInfo, check, lib, matched
from ropeway.networks.dds.raw_endpoints import RawReader, RawWriter, Taken, WriterIdentity
from ropeway.networks.dds.records import Discovered, EndpointRecord, Gone, Joined, MatchedEndpoint, NodesRecord
from ropeway.networks.dds.selftest import verify
from ropeway.networks.dds.vendors import HELPER_MARK, speaks_header
from ropeway.networks.dds.waitset import Pump, run_in_thread
from ropeway.networks.dds.writer_thread import Courier
from ropeway.qos import QoS

__all__ = ["DdsParticipant"]

log = logging.getLogger("ropeway.dds")

_BUILTIN_BATCH: Final = 64
_REMEMBERED_WRITERS: Final = 1024  # that have left, so that their last samples still have a name
_GUID_PREFIX_BYTES: Final = 12
_ANNOUNCE_QOS: Final = QoS(durability="transient_local", depth=1)
_LISTEN_QOS: Final = QoS(durability="transient_local", history="keep_all")


class DdsParticipant:
    """A participant in domain ``number``, with the node ``node`` (a full name).

    ``graph`` is what messages call it, ``on_discovered`` gets batches of records on the loop.
    """

    def __init__(
        self,
        graph: str,
        number: int,
        profile: Profile,
        node: str,
        gateway_id: str,
        clock: Callable[[], int],
        on_discovered: Callable[[list[Discovered]], None],
    ) -> None:
        self.graph, self.node, self.gateway_id, self.clock = graph, node, gateway_id, clock
        self.guid = b""
        self.identities: dict[int, WriterIdentity] = {}
        self.pump = Pump(graph, self._setup, self._teardown)
        self.taken = Taken()
        self.courier = Courier(graph)
        self._number, self._profile = number, profile
        self._on_discovered = on_discovered
        self._entity = 0
        self._acquired = False
        self._topics: dict[tuple[str, str], tuple[int, int, int]] = {}
        self._readers: dict[RawReader, None] = {}
        self._writers: dict[RawWriter, None] = {}
        self._hidden: set[RawReader | RawWriter] = set()
        self._own_readers: dict[int, bool] = {}
        self._left: deque[int] = deque()
        self._gid_bytes = GID_BYTES
        self._announcer: RawWriter | None = None
        self._announcing: asyncio.Handle | None = None

    async def open(self) -> None:
        """Join the domain; raises ``GraphUnavailable``."""
        await self.pump.start()
        try:
            self._start()
        except BaseException:
            await self.pump.stop()
            raise

    def _start(self) -> None:
        for topic, kind in (
            (raw.BUILTIN_PARTICIPANT, "participant"),
            (raw.BUILTIN_PUBLICATION, "publisher"),
            (raw.BUILTIN_SUBSCRIPTION, "subscription"),
        ):
            self._watch(topic, kind)
        mark = user_data(type_hash=DISCOVERY_TYPE_HASH)
        key = (DISCOVERY_TOPIC, DISCOVERY_TYPE)
        reader = self.create_reader(key, DISCOVERY_TYPE, _LISTEN_QOS, mark, self._on_nodes, _ignore)
        self._announcer = self.create_writer(key, _ANNOUNCE_QOS, mark, _ignore)
        # As the middleware of ROS does, its own two endpoints belong to no node.
        self._hidden = {reader, self._announcer}
        self._announce()

    async def withdraw(self) -> None:
        """Stop announcing our node; ``close`` does so, too, but one after the other with the rest."""
        if self._announcer is not None:
            await self.delete(self._announcer)

    async def close(self) -> None:
        """Leave the domain, with every entity that is left."""
        await asyncio.gather(*(self.delete(writer) for writer in list(self._writers)))
        for reader in self._readers:
            reader.closed = True
        if self._announcing is not None:
            self._announcing.cancel()
        await self.courier.stop()
        await self.pump.stop()

    # Entities ---------------------------------------------------------------------------------------------------

    def create_reader(
        self,
        topic: tuple[str, str],
        type: str,
        qos: QoS,
        user_data: bytes,
        deliver: Callable[[list[Sample]], None],
        dropped: Callable[[list[tuple[Undelivered, int]]], None],
        order: ByteOrder | None = None,
        matches: Callable[[list[tuple[MatchedEndpoint, ...]]], None] | None = None,
        all_gateways: bool = False,
        silent: bool = False,
    ) -> RawReader:
        """Create a reader of ``topic`` (DDS topic and DDS type); its samples carry ``type``. Raises ``DdsError``.

        ``matches`` gets the writers on the loop at each change. With ``all_gateways`` it reads from other processes of
        our own gateway, too. A ``silent`` one is on the network, and no node's, but reads nothing.
        """
        with self._using(topic) as (topic_entity, _), reader_qos(qos, user_data) as handle:
            entity = check(lib.create_reader(self._entity, topic_entity, handle, None), f"create reader {topic[0]}")
        # What several publishers kept may be more than one of them keeps.
        depth = None if qos.history == "keep_all" or qos.transient_local else max(qos.depth, 1)
        reader = RawReader(self, topic, type, entity, depth, deliver, dropped, order, all_gateways=all_gateways)
        reader.guid = raw.guid_of(entity)
        self._readers[reader] = None
        if silent:
            self._hidden.add(reader)
            return reader
        condition = check(lib.create_readcondition(entity, raw.ANY_STATE), "create_readcondition")
        reader.key = self.pump.attach(condition, reader.on_data)
        if matches is not None:
            reader.matches = Matches(self.pump, entity, matches, writer=False)
        self._announce_soon()
        return reader

    def create_writer(
        self,
        topic: tuple[str, str],
        qos: QoS,
        user_data: bytes,
        refused: Callable[[Undelivered], None],
        demand: Callable[[int], None] | None = None,
        matches: Callable[[list[tuple[MatchedEndpoint, ...]]], None] | None = None,
    ) -> RawWriter:
        """Create a writer on ``topic``; ``demand`` gets the number of others' readers on the loop.

        Raises ``DdsError``.

        ``matches``, which goes without ``demand``, gets the readers on the loop at each change.
        """
        with self._using(topic) as (topic_entity, sertype), writer_qos(qos, user_data) as handle:
            entity = check(lib.create_writer(self._entity, topic_entity, handle, None), f"create writer {topic[0]}")
        depth = None if qos.history == "keep_all" else max(qos.depth, 1)
        writer = RawWriter(self, topic, entity, sertype, depth, refused)
        writer.guid = raw.guid_of(entity)
        self._writers[writer] = None
        if demand is not None:
            tell = demand
            check(lib.set_status_mask(entity, raw.PUBLICATION_MATCHED), "set_status_mask")

            def on_counts(counts: list[int]) -> None:
                if not writer.closed:
                    tell(counts[-1])

            writer.key = self.pump.attach(entity, lambda: self._on_matched(writer, on_counts))
        elif matches is not None:
            writer.matches = Matches(self.pump, entity, matches, writer=True)
        self._announce_soon()
        return writer

    async def delete(self, part: RawReader | RawWriter) -> None:
        """Remove a reader or writer; nothing of it reaches the loop after this returns."""
        if part.closed:
            return
        part.closed = True
        self._hidden.discard(part)
        if isinstance(part, RawReader):
            del self._readers[part]
        else:
            del self._writers[part]
        self.pump.detach(part.key)
        if part.matches is not None:
            part.matches.closed = True
            self.pump.detach(part.matches.key)
        self._announce_soon()
        if self.pump.stopped:
            return
        if isinstance(part, RawWriter) and part.busy:
            await self.courier.flush()
        if isinstance(part, RawWriter) and lib.wait_for_acks(part.entity, 0):
            # DDS waits up to a second for readers that have not got everything yet; the pump cannot.
            await run_in_thread(f"ropeway {self.graph} linger", lambda: self._delete(part))
        else:
            await self.pump.call(lambda: self._delete(part))
        self._release_topic(part.topic)

    def matched_writers(self, reader: RawReader) -> int:
        """Return the number of writers that a reader is matched with."""
        return len(matched(lib.get_matched_publications, reader.entity))

    @contextlib.contextmanager
    def _using(self, key: tuple[str, str]) -> Iterator[tuple[int, int]]:
        """Provide a topic for an endpoint that is made in the ``with`` block, and release it if that fails."""
        topic = self._topic(key)
        try:
            yield topic
        except BaseException:
            self._release_topic(key)
            raise

    def _topic(self, key: tuple[str, str]) -> tuple[int, int]:
        entity, sertype, users = self._topics.get(key) or (*raw.create_topic(self._entity, *key), 0)
        self._topics[key] = (entity, sertype, users + 1)
        return entity, sertype

    def _release_topic(self, key: tuple[str, str]) -> None:
        entity, sertype, users = self._topics[key]
        if users > 1:
            self._topics[key] = (entity, sertype, users - 1)
        else:
            del self._topics[key]
            check(lib.delete(entity), "delete topic")

    def _delete(self, part: RawReader | RawWriter) -> None:
        if isinstance(part, RawReader):
            part.discard()
        check(lib.delete(part.entity), "delete endpoint")

    # The thread -------------------------------------------------------------------------------------------------

    def _setup(self) -> int:
        raw.load(self.graph)
        domain.acquire(self.graph, self._number, self._profile)
        self._acquired = True
        qos = lib.create_qos()
        mark = b"enclave=/;"
        lib.qset_userdata(qos, mark, len(mark))
        entity: int = lib.create_participant(self._number, qos, None)
        lib.delete_qos(qos)
        self._entity = check(entity, "create participant")
        self.guid = raw.guid_of(self._entity)
        _, sertype = self._topic((DISCOVERY_TOPIC, DISCOVERY_TYPE))
        verify(self.graph, self._entity, sertype)
        return self._entity

    def _teardown(self) -> None:
        for reader in self._readers:
            reader.discard()
        if self._entity:
            check(lib.delete(self._entity), "delete participant")
        if self._acquired:
            self._acquired = False
            domain.release(self._number)

    def identify(self, reader: int, handle: int) -> WriterIdentity:
        """Return the identity of the writer behind a publication handle that discovery has not announced yet."""
        data = lib.get_matched_publication_data(reader, handle)
        if not data:
            return WriterIdentity(handle.to_bytes(16, "big"))
        try:
            identity = self._identity(bytes(data.contents.key), parse_user_data(data.contents.qos))
        finally:
            lib.builtintopic_free_endpoint(data)
        self.identities[handle] = identity
        return identity

    def _identity(self, guid: bytes, marks: dict[str, str]) -> WriterIdentity:
        gateway = marks.get("ropeway", "")
        own = bool(gateway) and gateway == self.gateway_id
        return WriterIdentity(guid, relayed=bool(gateway) and not own, wanted=not own, helper=HELPER_MARK in marks)

    def _on_matched(self, writer: RawWriter, tell: Callable[[list[int]], None]) -> None:
        if writer.closed:
            return
        status = ct.c_uint32()
        code = lib.take_status(writer.entity, ct.byref(status), raw.PUBLICATION_MATCHED)
        if code < 0 and writer not in self._writers:  # deleted meanwhile
            return
        check(code, "take_status")
        handles = matched(lib.get_matched_subscriptions, writer.entity)
        self.pump.push(tell, [sum(not self._is_own_reader(writer.entity, handle) for handle in handles)])

    def _is_own_reader(self, writer: int, handle: int) -> bool:
        """Return whether the reader belongs to another process of our own gateway."""
        if not self.gateway_id:
            return False
        known = self._own_readers.get(handle)
        if known is None:
            data = lib.get_matched_subscription_data(writer, handle)
            if not data:
                return False
            try:
                known = parse_user_data(data.contents.qos).get("ropeway") == self.gateway_id
            finally:
                lib.builtintopic_free_endpoint(data)
            self._own_readers[handle] = known
        return known

    def _watch(self, topic: int, kind: str) -> None:
        reader = check(lib.create_reader(self._entity, topic, None, None), "create builtin reader")
        condition = check(lib.create_readcondition(reader, raw.ANY_STATE), "create_readcondition")
        samples, infos = (ct.c_uint64 * _BUILTIN_BATCH)(), (SampleInfo * _BUILTIN_BATCH)()
        view = memoryview(infos).cast("B")

        def on_data() -> None:
            samples[0] = 0
            count = check(lib.take(reader, samples, infos, _BUILTIN_BATCH, _BUILTIN_BATCH), "take builtin topic")
            if not count:
                return
            try:
                self.pump.push(self._on_discovered, read(count))
            finally:
                lib.return_loan(reader, samples, count)

        def read(count: int) -> list[Discovered]:
            found: list[Discovered] = []
            for address, (state, valid, _, handle, _) in zip(
                samples[:count], INFO.iter_unpack(view[: count * INFO.size]), strict=True
            ):
                if state != ALIVE:
                    found.append(self._gone(kind, handle, address))
                elif valid and kind == "participant":
                    data = ParticipantData.from_address(address)
                    if HELPER_MARK not in parse_user_data(data.qos):  # they have no nodes
                        found.append(Joined(bytes(data.key)))
                elif valid:
                    found.append(self._found(kind, handle, BuiltinEndpoint.from_address(address)))
            return found

        self.pump.attach(condition, on_data)

    def _found(self, kind: str, handle: int, data: BuiltinEndpoint) -> EndpointRecord:
        marks = parse_user_data(data.qos)
        guid = bytes(data.key)
        if kind == "publisher":
            self.identities[handle] = self._identity(guid, marks)
        else:
            self._own_readers[handle] = bool(self.gateway_id) and marks.get("ropeway") == self.gateway_id
        participant = bytes(data.participant_key)
        return EndpointRecord(
            kind=kind,
            handle=handle,
            guid=guid,
            participant=participant,
            dds_topic=(data.topic or b"").decode("utf-8", "replace"),
            dds_type=(data.type or b"").decode("utf-8", "replace"),
            qos=read_qos(data.qos, tells_history=speaks_header(guid)),
            type_hash=marks.get("typehash", ""),
            gateway=marks.get("ropeway", ""),
            local=participant == self.guid,
            since_ns=since_of(marks),
            helper=HELPER_MARK in marks,
        )

    def _gone(self, kind: str, handle: int, address: int) -> Gone:
        if kind == "publisher":
            self._left.append(handle)
            if len(self._left) > _REMEMBERED_WRITERS:
                self.identities.pop(self._left.popleft(), None)
        elif kind == "subscription":
            self._own_readers.pop(handle, None)
        return Gone(kind, handle, bytes(ParticipantData.from_address(address).key))

    # Nodes ------------------------------------------------------------------------------------------------------

    def _on_nodes(self, batch: list[Sample]) -> None:
        found: list[Discovered] = []
        for sample in batch:
            entities = parse(sample.payload)
            # A participant speaks for itself alone: the GUIDs of its entities begin like its own.
            if entities is None or entities.guid[:_GUID_PREFIX_BYTES] != sample.origin[:_GUID_PREFIX_BYTES]:
                log.debug("%s: %d bytes on %s are not such a message", self.graph, len(sample.payload), DISCOVERY_TOPIC)
                continue
            found.append(NodesRecord(entities.guid, entities.nodes, entities.gid_bytes, local=False))
        if found:
            self._on_discovered(found)

    @property
    def is_old(self) -> bool:
        """Whether all other participants are of ROS 2 Humble or older."""
        return self._gid_bytes == OLD_GID_BYTES

    def follow_gid_bytes(self, sizes: set[int]) -> None:
        """Write gids as the others do: in 24 bytes where all of them are of ROS 2 Humble or older."""
        size = OLD_GID_BYTES if sizes == {OLD_GID_BYTES} else GID_BYTES
        if size != self._gid_bytes:
            self._gid_bytes = size
            if self.is_old:
                log.info("%s: all nodes are of ROS 2 Humble or older; messages get the layouts of Humble", self.graph)
            self._announce_soon()

    def _announce_soon(self) -> None:
        if self._announcing is None:
            self._announcing = asyncio.get_running_loop().call_soon(self._announce)

    def _announce(self) -> None:
        self._announcing = None
        if self._announcer is None or self._announcer.closed:
            return
        readers = tuple(r.guid for r in self._readers if r not in self._hidden)
        writers = tuple(w.guid for w in self._writers if w not in self._hidden)
        node = NodeEntities(self.node, readers, writers)
        self._announcer.write(encode(ParticipantEntities(self.guid, (node,), self._gid_bytes)))
        self._on_discovered([NodesRecord(self.guid, (node,), self._gid_bytes, local=True)])


def _ignore(_: object) -> None:
    """Ignore a drop on ros_discovery_info: the next message of that participant replaces it."""
