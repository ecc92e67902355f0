"""What the thread of a participant tells the loop about the network."""

from __future__ import annotations

from dataclasses import dataclass

from ropeway.graph.dds.nodes import NodeEntities
from ropeway.qos import QoS

__all__ = ["Discovered", "EndpointRecord", "Gone", "Joined", "NodesRecord"]


@dataclass(frozen=True, slots=True)
class EndpointRecord:
    """A writer (``publisher``) or reader (``subscription``) that was discovered, or has changed."""

    kind: str
    handle: int
    guid: bytes
    participant: bytes
    dds_topic: str
    dds_type: str
    qos: QoS
    type_hash: str
    gateway: str
    local: bool


@dataclass(frozen=True, slots=True)
class Joined:
    """A participant that has come."""

    participant: bytes


@dataclass(frozen=True, slots=True)
class Gone:
    """A ``publisher``, ``subscription`` or ``participant`` that has left."""

    kind: str
    handle: int
    guid: bytes


@dataclass(frozen=True, slots=True)
class NodesRecord:
    """All nodes of a participant, as it told last, with gids of so many bytes."""

    participant: bytes
    nodes: tuple[NodeEntities, ...]
    gid_bytes: int
    local: bool


Discovered = EndpointRecord | Gone | Joined | NodesRecord
