"""Global names: 32 bytes that say nothing about place, nor about what they name.

FogROS2-SGC (thesis, 3.1) hashes a topic's metadata with SHA-256. Whoever guesses the metadata can confirm the guess
then, so here it is an HMAC under the fleet's name secret: the same metadata gives the same name at every site that
has the secret, and nobody else can make or recognise it.
"""

from __future__ import annotations

import hashlib
import hmac
import struct
from dataclasses import astuple, dataclass
from typing import Final

__all__ = ["KINDS", "NAME_BYTES", "Metadata", "global_name"]

NAME_BYTES: Final = 32
KINDS: Final = ("topic", "service", "action")

_TAG: Final = b"ropeway name 1"


@dataclass(frozen=True, slots=True)
class Metadata:
    """The parts of a global name besides the name and the type. Who shares a name agrees on it.

    ``unique`` tells deployments of one name apart that shall not be replicas of each other; ``node`` is the name of the
    node that has it, where that shall tell names apart, too.
    """

    author: str = ""
    maintainer: str = ""
    description: str = ""
    unique: str = ""
    node: str = ""

    def fields(self) -> tuple[str, ...]:
        """Return the fields of names and advertisements: ``node``, which came later, only if there is one."""
        return astuple(self) if self.node else astuple(self)[:-1]


def global_name(secret: bytes, kind: str, name: str, type: str, metadata: Metadata | None = None) -> bytes:
    """Return the global name of a ``topic``, ``service`` or ``action``: HMAC-SHA-256 under ``secret``.

    The message is a tag and then each field behind its length (32 bit, big-endian), so that no two sets of fields give
    the same bytes. ``name`` is absolute, ``type`` canonical (``pkg/msg/Name``).
    """
    if kind not in KINDS:
        raise ValueError(f"expected one of {', '.join(KINDS)}, got {kind!r}")
    mac = hmac.new(secret, _TAG, hashlib.sha256)
    for field in (kind, name, type, *(metadata or Metadata()).fields()):
        raw = field.encode()
        mac.update(struct.pack(">I", len(raw)) + raw)
    return mac.digest()
