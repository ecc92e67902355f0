"""The border of a network whose types may have other layouts than ours: another distribution, or other versions.

On our side every message has our layout. Incoming messages are converted to it, and outgoing ones to the layout of
their readers; fields are matched by name.
"""

from __future__ import annotations

from typing import Protocol, runtime_checkable

from ropeway.errors import DecodeError, TypesError
from ropeway.types import TypeRegistry

__all__ = ["Border", "Distributed"]


@runtime_checkable
class Distributed(Protocol):
    """A graph that knows of which distribution of ROS 2 its network is."""

    @property
    def distro(self) -> str:
        """The distribution, as it was given or found out; ``""`` where neither is so."""


class Border:
    """The border between ``registry`` and a network; ``network`` has its types where they were given.

    A graph without a registry of definitions passes everything as it is.
    """

    def __init__(self, registry: object, network: TypeRegistry | None = None) -> None:
        self.ours = registry if isinstance(registry, TypeRegistry) else None
        self.network = network
        self.touched: dict[str, bool] = {}
        """Results of ``touches`` for each type, as long as ``state`` is that of our definitions."""
        self.state = 0

    def touches(self, type: str) -> bool:
        """Return whether messages of ``type`` may have to be translated."""
        ours = self.ours
        if ours is None:
            return False
        if self.state != ours.changes:
            self.state = ours.changes
            self.touched.clear()
        found = self.touched.get(type)
        if found is None:
            others, network = ours.others, self.network
            differs = network is not None and network.differs(type)
            found = self.touched[type] = differs or (others is not None and others.touches(type))
        return found

    def incoming(self, type: str, payload: bytes, writer: TypeRegistry | None = None) -> bytes:
        """Return what came in, in our layout; ``writer`` has the types of who wrote it, where that is known.

        What fits no layout is returned as it is.
        """
        ours = self.ours
        if ours is None or writer is ours:
            return payload
        untouched = self.touched.get(type) is False and self.state == ours.changes
        if untouched or not self.touches(type):
            return payload
        theirs = writer or self.network
        translate = None if theirs is None else theirs.inward(type)
        if translate is not None:
            try:
                return translate(payload)
            except TypesError:  # another writer on this network, or no message at all
                pass
        try:
            return ours.codec(type).fitting(payload)
        except TypesError:
            return payload

    def outgoing(self, type: str, payload: bytes, reader: TypeRegistry | None = None) -> bytes:
        """Return an outgoing message in the layout of the network; ``reader`` has the types of its reader.

        The message may be in the layout of a third network, as those of recordings are. What fits no layout is
        returned as it is. Raises ``ValueMismatch`` for values that the other layout cannot hold.
        """
        ours = self.ours
        if ours is None:
            return payload
        untouched = self.touched.get(type) is False and self.state == ours.changes
        if untouched or not self.touches(type):
            return payload
        theirs = self.network or reader
        translate = None if theirs is None else theirs.outward(type)
        try:
            return ours.codec(type).fitting(payload) if translate is None else translate(payload)
        except DecodeError:
            return payload
