"""Topics that we read from DDS: subscriptions, and the readers that they share."""

from __future__ import annotations

from typing import Protocol

from ropeway.errors import GraphUnavailable
from ropeway.graph.host import Host
from ropeway.graph.qos_adoption import AdoptingSubscription, Readers, SharedReader
from ropeway.networks.dds.byteorder import ByteOrder, Codec
from ropeway.networks.dds.discovery import DdsDiscovery
from ropeway.networks.dds.endpoint_qos import user_data
from ropeway.networks.dds.names import dds_topic, dds_type
from ropeway.networks.dds.participant import DdsParticipant
from ropeway.networks.dds.raw import DdsError
from ropeway.networks.dds.raw_endpoints import RawReader
from ropeway.qos import QoS

__all__ = ["DdsReaders", "DdsSubscription", "Types"]

DdsSubscription = AdoptingSubscription[RawReader]


class Types(Protocol):
    """The part of a type registry that is used here."""

    def has(self, name: str) -> bool:
        """Return whether the definition is known."""

    def hash(self, name: str) -> str:
        """Return ``RIHS01_…``, which ``ros2 topic info -v`` shows."""

    def codec(self, name: str) -> Codec:
        """Return the codec that tells big-endian messages from others."""


class DdsReadersHost(Host, Protocol):
    """The services of a graph for its readers."""

    gateway_id: str

    def type_hash(self, type: str) -> str:
        """Return ``RIHS01_…``, or ``""`` where nobody knows the type."""
        ...


class DdsReaders(Readers[RawReader]):
    """Holds the readers behind the subscriptions of an opened graph."""

    def __init__(
        self, graph: DdsReadersHost, participant: DdsParticipant, discovery: DdsDiscovery, types: Types | None
    ) -> None:
        super().__init__(graph)
        self._graph = graph
        self._participant, self._discovery, self._types = participant, discovery, types

    def offered(self, topic: str, type: str) -> list[QoS]:
        """See ``Readers``."""
        return self._discovery.offered(topic, type)

    def is_matched(self, reader: SharedReader[RawReader]) -> bool:
        """See ``Readers``."""
        if reader.raw is None:
            return True
        expected = len(self._discovery.offered(reader.topic, reader.type))
        return self._participant.matched_writers(reader.raw) >= expected

    def _make(self, reader: SharedReader[RawReader]) -> RawReader:
        topic, type = reader.topic, reader.type
        try:
            return self._participant.create_reader(
                (dds_topic(topic), dds_type(type)),
                type,
                reader.qos,
                user_data(type_hash=self._graph.type_hash(type), gateway_id=self._graph.gateway_id),
                reader.deliver,
                reader.dropped,
                self._byte_order(topic, type),
            )
        except DdsError as error:
            raise GraphUnavailable(self.name, str(error)) from error

    async def _delete(self, raw: RawReader) -> None:
        await self._participant.delete(raw)

    def _byte_order(self, topic: str, type: str) -> ByteOrder | None:
        types = self._types
        if types is None or not types.has(type):
            return None
        return ByteOrder(f"{self.name}: {topic}", lambda: types.codec(type))
