"""Provides what clients and services share: a writer and a reader that belong together, and their matches."""

from __future__ import annotations

import asyncio
import time
from collections.abc import Sequence
from typing import Final, Protocol

from ropeway.errors import InvalidTypeName
from ropeway.graph.base import Sample, Undelivered, resolve_name
from ropeway.graph.host import Host
from ropeway.graph.signal import Signal
from ropeway.networks.dds import raw
from ropeway.networks.dds.endpoint_qos import user_data
from ropeway.networks.dds.layouts import Layouts
from ropeway.networks.dds.names import dds_service_topics, dds_type
from ropeway.networks.dds.participant import DdsParticipant
from ropeway.networks.dds.raw_endpoints import RawReader, RawWriter
from ropeway.networks.dds.records import MatchedEndpoint
from ropeway.networks.dds.vendors import VendorHelper
from ropeway.qos import QoS
from ropeway.types import TypeRegistry
from ropeway.types.definition import canonical_name

__all__ = ["LITTLE_ENDIAN", "DdsCallHost", "Ends"]

LITTLE_ENDIAN: Final = 1
"""The second byte of CDR in our byte order."""

# Volatile, as services of ROS 2 are; and nothing is replaced by something newer.
_QOS: Final = QoS(history="keep_all")


class DdsCallHost(Host, Protocol):
    """The services of a graph for its clients and services."""

    gateway_id: str
    helper: VendorHelper | None
    layouts: Layouts

    @property
    def participant(self) -> DdsParticipant:
        """The DDS side. Raises ``GraphUnavailable`` where the graph is not open."""
        ...

    @property
    def registry(self) -> TypeRegistry:
        """The definitions that default responses are made with."""
        ...

    def type_hash(self, type: str) -> str:
        """Return ``RIHS01_…``, or ``""`` where nobody knows the type."""
        ...

    def node_of(self, guid: bytes) -> str:
        """Return the full name of the node that an endpoint belongs to, or ``""``."""
        ...

    def little_endian(self, type: str, payload: bytes) -> bytes:
        """Return CDR in our byte order. Raises ``DecodeError``, ``UnknownType``."""
        ...

    async def remove(self, part: Ends) -> None:
        """Forget a part that was closed, and delete its endpoints."""
        ...


class Ends:
    """The endpoints of one client or service in this process.

    Raises ``InvalidName`` and ``InvalidTypeName``; ``type`` may be of an action's services, too.
    """

    serves = False

    def __init__(self, graph: DdsCallHost, service: str, type: str) -> None:
        self.service, self.type = resolve_name(service), canonical_name(type, "srv")
        if "/msg/" in self.type:
            raise InvalidTypeName(type)
        self.closed = False
        self._graph = graph
        self._loop = asyncio.get_running_loop()
        self._id = 0
        self._writer: RawWriter
        self._reader: RawReader
        self._readers: tuple[MatchedEndpoint, ...] = ()
        self._writers: tuple[MatchedEndpoint, ...] = ()
        self._changed = Signal()

    async def join(self, participant: DdsParticipant, pair: str) -> None:
        """Make the endpoints; ``pair`` is what marks them as one pair. Raises ``DdsError``.

        What hears comes first, so that who finds our writer finds our reader, too.
        """
        request, reply = dds_service_topics(self.service)
        parts = ((request, "_Request"), (reply, "_Response"))
        (hears, hear_part), (says, say_part) = parts if self.serves else parts[::-1]
        since_ns = time.time_ns()

        def mark(part: str) -> bytes:
            return user_data(
                extra=f"{'serviceid' if self.serves else 'clientid'}={pair};",
                type_hash=self._graph.type_hash(self.type + part),
                gateway_id=self._graph.gateway_id,
                since_ns=since_ns,
            )

        self._reader = participant.create_reader(
            (hears, dds_type(self.type, hear_part)),
            self.type,
            _QOS,
            mark(hear_part),
            self.on_samples,
            self._on_dropped,
            matches=self._on_writers,
            all_gateways=True,
        )
        try:
            self._writer = participant.create_writer(
                (says, dds_type(self.type, say_part)),
                _QOS,
                mark(say_part),
                lambda _: None,  # ``send`` tells
                matches=self._on_readers,
            )
        except BaseException:
            await participant.delete(self._reader)
            raise
        self._id = raw.handle_of(self._writer.entity)

    async def leave(self, participant: DdsParticipant) -> None:
        """Delete the endpoints."""
        await participant.delete(self._reader)
        await participant.delete(self._writer)

    def on_samples(self, batch: Sequence[Sample]) -> None:
        """Handle what arrives, on the loop."""
        raise NotImplementedError

    def on_match(self) -> None:
        """Take the current list of matched endpoints."""
        raise NotImplementedError

    def _on_dropped(self, counts: list[tuple[Undelivered, int]]) -> None:
        for reason, count in counts:
            self._graph.drops[self.service, reason] += count

    def _on_readers(self, batch: list[tuple[MatchedEndpoint, ...]]) -> None:
        self._readers = batch[-1]
        self._tell()

    def _on_writers(self, batch: list[tuple[MatchedEndpoint, ...]]) -> None:
        self._writers = batch[-1]
        self._tell()

    def _tell(self) -> None:
        if self.closed:
            return
        self.on_match()
        self._changed.notify()
