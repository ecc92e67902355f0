"""Defines what a participant's thread reports to the loop about the network."""

from __future__ import annotations

from dataclasses import dataclass

from ropeway.networks.dds.nodes import NodeEntities
from ropeway.qos import QoS

__all__ = ["Discovered", "EndpointRecord", "Gone", "Joined", "MatchedEndpoint", "NodesRecord"]


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
    since_ns: int = 0
    helper: bool = False


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
    """The nodes of a participant, as it announced last, and the size of its gids."""

    participant: bytes
    nodes: tuple[NodeEntities, ...]
    gid_bytes: int
    local: bool


@dataclass(frozen=True, slots=True)
class MatchedEndpoint:
    """The far end of a match.

    ``pair`` is what the two endpoints of one service or client have in common, ``""`` where they do not tell; ``depth``
    is how many samples it keeps, 0 where that is not known. ``ours`` marks Ropeway's, ``helper`` a ``VendorHelper``'s.
    """

    guid: bytes
    pair: str = ""
    depth: int = 0
    ours: bool = False
    helper: bool = False


Discovered = EndpointRecord | Gone | Joined | NodesRecord
