"""Defines what is known of another gateway, and the forms of its announcements."""

from __future__ import annotations

import asyncio
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, Final

from ropeway.errors import SealError
from ropeway.limits import OVERLAY_WAYS
from ropeway.networks.overlay.announcement import NoteKey
from ropeway.networks.overlay.crypto.certificate import Certificate
from ropeway.networks.overlay.refusal import Refusal

__all__ = ["CHALLENGE_BYTES", "SHAPES", "KnownGateway", "clock_ahead_s", "gateway_of", "read_told", "unreachable"]

CHALLENGE_BYTES: Final = 16
_SKEW_S: Final = 120.0  # of a list that does not answer our challenge: an older one may be sent again
_NO_WAY_S: Final = 4.0  # a way is there within tenths of a second, and a token goes within three
_NO_WAY_BUSY_S: Final = 60.0  # while others tell who they are: links made anew would have all of them ask again
_NS: Final = 10**9

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
    joined: float = float("-inf")  # when it told who it is
    aims: bool = False  # it knows advertisements that are for one gateway alone
    ways: int = 0  # by which it may send the same packet; 0 if it tells no copies from replays
    clock_ahead_s: float = 0.0  # its clock, beside ours

    def introduced(
        self, certificate: Certificate, notes: NoteKey, hello: Mapping[str, Any], ahead_s: float, now_s: float
    ) -> None:
        """Take what its list begins with, and by how much its clock is ahead."""
        if self.certificate is None:
            self.joined = now_s
        self.certificate, self.name, self.notes = certificate, certificate.name, notes
        self.told_ns = max(self.told_ns, hello["t"])
        self.clock_ahead_s, self.heard = ahead_s, now_s
        self.aims = hello.get("aims") is True
        ways = hello.get("ways")
        self.ways = ways if type(ways) is int and 0 < ways <= OVERLAY_WAYS else 0

    def silent(self, now_s: float, patience_s: float = _NO_WAY_S) -> bool:
        """Return whether it has not told who it is for so long that there must be no way to it."""
        return self.certificate is None and bool(self.unanswered) and now_s - self.unanswered > patience_s


def unreachable(gateways: Mapping[bytes, KnownGateway], now_s: float) -> bytes | None:
    """Return a gateway that is heard of, but has not told who it is for so long that there must be no way to it.

    While others tell who they are, as when many start at once, it is only busy, unless that takes very long.
    """
    busy = any(now_s - known.joined < _NO_WAY_S for known in gateways.values())
    patience_s = _NO_WAY_BUSY_S if busy else _NO_WAY_S
    return next((id for id, known in gateways.items() if known.silent(now_s, patience_s)), None)


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


def clock_ahead_s(hello: Mapping[str, Any], name: str, challenge: bytes | None, now_ns: int) -> float:
    """Return by how much the clock of a gateway is ahead of ours, after the time that its list tells.

    A list with our ``challenge`` answers what we asked just now, so it is no older one that somebody sends again,
    whatever the clocks say; ``None`` for one from a sealed channel, which is as good. Raises ``SealError`` for an
    answer to the challenge of others, and for one without any whose time is far from ours.
    """
    ahead_s = (hello["t"] - now_ns) / _NS
    answered = hello.get("q")
    if challenge is None or answered == challenge:
        return float(ahead_s)
    if answered:
        raise SealError(Refusal.REPLAYED, f"a list of {name} that was told to somebody else")
    if abs(ahead_s) > _SKEW_S:
        way = "ahead of" if ahead_s > 0 else "behind"
        raise SealError(
            Refusal.TOO_OLD,
            f"the clock of {name} is {abs(ahead_s):.0f} s {way} ours, or its list is an old one that is sent again; "
            "set the clocks, or update that member, as newer ones prove that their lists are new",
        )
    return float(ahead_s)
