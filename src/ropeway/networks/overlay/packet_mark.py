"""Marks a packet of data with its number, for acknowledgements, and with its place if it is one of several parts.

The mark travels as an attachment, which older members ignore; parts are sent only to members that know marks. It is not
sealed: instead of changing it, a router could as well delay or drop the packet. The packet that the parts make up is
sealed.

A packet that goes by several ways of its sender has the number of each but the first behind its mark, so that who reads
it tells copies from replays. Only to members that know of it are packets sent by several ways.
"""

from __future__ import annotations

import struct
from typing import Final, NamedTuple

from ropeway.delivery.outbox import LANES

__all__ = ["Mark", "by_way"]

_WHOLE: Final = struct.Struct(">BBQ")  # version, lane, number
_PART: Final = struct.Struct(">BBQQQ")  # and: where the part begins, and how long the packet is
_VERSION: Final = 1


class Mark(NamedTuple):
    """The number of a packet within its lane; ``size`` is 0 where it is whole, else it is a part from ``at`` on.

    ``way`` is the number of the sender's session that it was sent by.
    """

    lane: int
    number: int
    at: int = 0
    size: int = 0
    way: int = 0

    def to_bytes(self) -> bytes:
        """Return it as it travels by the first way; see ``by_way``."""
        if self.size:
            return _PART.pack(_VERSION, self.lane, self.number, self.at, self.size)
        return _WHOLE.pack(_VERSION, self.lane, self.number)

    @classmethod
    def read(cls, raw: bytes) -> Mark | None:
        """Return what stands beside a packet, ``None`` where that is nothing we know."""
        form = next((form for form in (_WHOLE, _PART) if len(raw) - form.size in (0, 1)), None)
        if form is None:
            return None
        version, *fields = form.unpack_from(raw)
        mark = cls(*fields)._replace(way=raw[-1] if len(raw) > form.size else 0)
        return mark if version == _VERSION and mark.lane < LANES else None


def by_way(mark: bytes, way: int) -> bytes:
    """Return a mark as it travels by one of its sender's ways."""
    return mark + bytes([way]) if way else mark
