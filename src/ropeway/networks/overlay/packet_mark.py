"""Marks a packet of data with its number, for acknowledgements, and with its place if it is one of several parts.

The mark travels as an attachment, which older members ignore; parts are sent only to members that know marks. It is not
sealed: instead of changing it, a router could as well delay or drop the packet. The packet that the parts make up is
sealed.
"""

from __future__ import annotations

import struct
from typing import Final, NamedTuple

from ropeway.delivery.outbox import LANES

__all__ = ["Mark"]

_WHOLE: Final = struct.Struct(">BBQ")  # version, lane, number
_PART: Final = struct.Struct(">BBQQQ")  # and: where the part begins, and how long the packet is
_VERSION: Final = 1


class Mark(NamedTuple):
    """The number of a packet within its lane; ``size`` is 0 where it is whole, else it is a part from ``at`` on."""

    lane: int
    number: int
    at: int = 0
    size: int = 0

    def to_bytes(self) -> bytes:
        """Return it as it travels."""
        if self.size:
            return _PART.pack(_VERSION, *self)
        return _WHOLE.pack(_VERSION, self.lane, self.number)

    @classmethod
    def read(cls, raw: bytes) -> Mark | None:
        """Return what stands beside a packet, ``None`` where that is nothing we know."""
        if len(raw) == _WHOLE.size:
            version, *fields = _WHOLE.unpack(raw)
        elif len(raw) == _PART.size:
            version, *fields = _PART.unpack(raw)
        else:
            return None
        mark = cls(*fields)
        return mark if version == _VERSION and mark.lane < LANES else None
