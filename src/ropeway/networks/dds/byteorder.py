"""Finds big-endian senders, which the opaque types of ``raw`` hide.

Cyclone DDS labels every sample as of this machine's byte order and turns round what its type names, which for an
opaque type is nothing. So the first message of each writer is read with its definition: where it makes sense only
big-endian, all messages of that writer are rewritten. A type without any length or text in it reads both ways; such
a message passes as it is. So do types whose definition is not known.
"""

from __future__ import annotations

import logging
from collections.abc import Callable, Mapping
from typing import Any, Final, Protocol

from ropeway.errors import DecodeError, TypesError

__all__ = ["ByteOrder", "Codec"]

log = logging.getLogger("ropeway.dds")

_BIG: Final = b"\0\0"
_MAX_WRITERS: Final = 4096


class Codec(Protocol):
    """The part of a message codec that is used here."""

    def decode(self, cdr: bytes) -> dict[str, Any]:
        """Decode the message."""

    def encode(self, message: Mapping[str, Any]) -> bytes:
        """Encode the message as little-endian CDR."""


class ByteOrder:
    """Tracks the byte order of the writers of one topic. ``make`` gives the codec of its type, and may raise
    ``TypesError``.
    """

    def __init__(self, topic: str, make: Callable[[], Codec]) -> None:
        self._topic = topic
        self._make = make
        self.big: dict[bytes, bool] = {}  # by writer, as far as it is known

    def native(self, writer: bytes, payload: bytes) -> bytes | None:
        """Return ``payload`` in the byte order that its header claims; ``None`` if a big-endian one cannot be read."""
        big = self.big.get(writer)
        if big is None:
            big = self._examine(writer, payload)
        if not big:
            return payload
        codec = self._make()
        try:
            return codec.encode(codec.decode(_BIG + payload[2:]))
        except TypesError:
            return None

    def _examine(self, writer: bytes, payload: bytes) -> bool:
        big = False
        try:
            codec = self._make()
            try:
                codec.decode(payload)
            except DecodeError:
                codec.decode(_BIG + payload[2:])
                big = True
                log.warning("%s: writer %s is on a big-endian machine", self._topic, writer.hex())
        except TypesError:
            pass  # neither order, or no definition: whoever decodes it says so
        if len(self.big) >= _MAX_WRITERS:
            self.big.clear()
        self.big[writer] = big
        return big
