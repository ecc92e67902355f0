"""Brings messages into the layout of the type hash under which they travel, and out of it.

On a network of rmw_zenoh the hash is a part of the key, so each message says whose definition it follows.
"""

from __future__ import annotations

from typing import Final

from ropeway.errors import TypesError
from ropeway.graph.layout_border import Border
from ropeway.networks.zenoh.tokens import NO_HASH
from ropeway.types import TypeRegistry

__all__ = ["LITTLE_ENDIAN", "HashedLayouts"]

LITTLE_ENDIAN: Final = 1
"""The second byte of CDR in our byte order."""

_WITHOUT_HASHES: Final = "humble"


class HashedLayouts:
    """The border of a network of rmw_zenoh."""

    def __init__(self, border: Border) -> None:
        self._border = border

    @property
    def distro(self) -> str:
        """See ``Distributed.distro``."""
        network = self._border.network
        return network.given_distro if network is not None else ""

    def own_hash(self, type: str) -> str:
        """Return the hash of a message or service type as the network defines it, or we do; ``NO_HASH`` if neither."""
        registry = self._border.network or self._border.ours
        return registry.hash(type) if registry is not None and registry.has(type) else NO_HASH

    def read(self, type: str, payload: bytes, type_hash: str, *, part: str = "") -> bytes:
        """Return in our layout and byte order what came under a hash of ``type``.

        ``part`` is ``_Request`` or ``_Response`` for services. Raises ``TypesError`` for what cannot be converted.
        """
        border, of = self._border, type + part
        if payload[1] != LITTLE_ENDIAN:
            if border.ours is None:
                return payload
            codec = border.ours.codec(of)
            return codec.encode(codec.decode(payload))
        return border.incoming(of, payload, self._owner(type, type_hash)) if border.touches(of) else payload

    def write(self, type: str, payload: bytes, type_hash: str, *, part: str = "") -> bytes:
        """Return a message of ours in the layout of a hash of ``type``. Raises ``TypesError``."""
        border, of = self._border, type + part
        return border.outgoing(of, payload, self._owner(type, type_hash)) if border.touches(of) else payload

    def _owner(self, type: str, type_hash: str) -> TypeRegistry | None:
        """Return whose definition has the hash, ``None`` where nobody knows; nodes of Humble have none."""
        ours = self._border.ours
        others = ours.others if ours is not None else None
        if others is None:
            return None
        if type_hash == NO_HASH:
            return others.variant(_WITHOUT_HASHES)
        try:
            return others.by_hash(type, type_hash)
        except TypesError:
            return None
