"""Defines what is known of another gateway, and the forms of its announcements."""

from __future__ import annotations

import asyncio
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, Final

from ropeway.errors import SealError
from ropeway.networks.overlay.announcement import NoteKey
from ropeway.networks.overlay.crypto.certificate import Certificate
from ropeway.networks.overlay.refusal import Refusal

__all__ = ["SHAPES", "KnownGateway", "gateway_of", "read_told"]

SHAPES: Final[Mapping[str, Mapping[str, type]]] = {
    "heartbeat": {"t": int, "v": int, "w": dict, "r": int},
    "delta": {"v": int, "add": list, "del": list},
    "hello": {"c": bytes, "n": str, "t": int, "v": int, "of": int},
    "adverts": {"t": int, "a": list},
}


@dataclass(slots=True)
class KnownGateway:
    """Holds what we know of another gateway."""

    certificate: Certificate | None = None
    name: str = ""
    version: int = -1
    told_ns: int = 0  # the sender's clock, of its newest heartbeat
    heard: float = 0.0
    suspect: float | None = None
    sync: asyncio.Task[None] | None = None
    wanted: int = -1
    notes: NoteKey | None = None
    synced: float = float("-inf")
    unanswered: float = 0.0  # since when it does not answer
    aims: bool = False  # it knows advertisements that are for one gateway alone


def read_told(answer: Any) -> tuple[list[bytes], NoteKey]:
    """Read the answer of another gateway's ``told_list``. Raises ``SealError``."""
    notes = answer.get("n") if isinstance(answer, dict) else None
    if not isinstance(notes, list) or any(type(note) is not bytes for note in notes):
        raise SealError(Refusal.MALFORMED, "a list")
    return notes, NoteKey.read(answer.get("k"), answer.get("i"))


def gateway_of(key: str) -> bytes | None:
    """Return the gateway that a key names, ``None`` where it names none."""
    try:
        gateway = bytes.fromhex(key.rsplit("/", 1)[-1])
    except ValueError:
        return None
    return gateway if len(gateway) == 16 else None
