"""The sending side of one publisher: numbers messages, seals them, keeps the last ones and hands out its keys."""

from __future__ import annotations

import threading
import time
from collections import deque
from collections.abc import Callable, Collection, Sequence
from typing import Any, Final

from ropeway.errors import SealError
from ropeway.limits import OVERLAY_HISTORY_BYTES
from ropeway.networks.overlay.crypto.certificate import Certificate
from ropeway.networks.overlay.crypto.seal import Sealer
from ropeway.networks.overlay.packet_item import RAW, PacketItem, frame, pack
from ropeway.networks.overlay.reader_proofs import ReaderProofs
from ropeway.networks.overlay.refusal import Refusal

__all__ = ["PublisherSource"]

_KEEP_BYTES: Final = 64 << 20  # above, the oldest go, whatever the depth; one message always stays
_ON_THE_WAY_S: Final = 0.9  # a little less than the time between two heartbeats
_KEEP_ALL: Final = 10_000


class PublisherSource:
    """Numbers, seals and keeps the messages of one publisher. ``name`` is its global name, ``endpoint`` its own 16
    bytes, ``topic`` its ROS name.

    ``depth`` messages are kept for those who missed them or come late, ``None`` for as many as fit, 0 for none;
    ``lifespan_s`` is how long. Without ``replay`` those who come late get nothing of what was sent before. ``may``
    decides, beyond certificates, who may read. ``rotate_s``: how long a content key serves. With ``sessions`` packets
    are proven to each reader alone, where all agree to that, and not signed. ``seal`` and ``sent`` may be called in the
    thread that sends; all else belongs to the event loop.
    """

    def __init__(
        self,
        name: bytes,
        endpoint: bytes,
        topic: str,
        sign: Callable[[bytes], bytes],
        *,
        depth: int | None,
        lifespan_s: float | None,
        may: Callable[[Certificate], bool],
        rotate_s: float = 600.0,
        replay: bool = True,
        sessions: bool = False,
    ) -> None:
        self.name, self.endpoint, self.topic = name, endpoint, topic
        self.number = 0
        self.active = 0.0
        self._sent = 0
        self._tails = (0, 0, float("-inf"))  # what should have come, what may be on the way, and since when
        self._sealer = Sealer(name, endpoint, sign)
        self._depth = _KEEP_ALL if depth is None else depth
        self._lifespan_ns = None if lifespan_s is None else int(lifespan_s * 1e9)
        self._kept: deque[PacketItem] = deque()
        self._kept_bytes = 0
        self._may = may
        self._rotate_s = rotate_s
        self._rotated = time.monotonic()
        self._readers: dict[bytes, Certificate] = {}
        self._replay = replay
        self._first: dict[bytes, int] = {}  # the newest number when a reader came, where it gets nothing older
        self._proofs = ReaderProofs() if sessions else None
        self._lock = threading.Lock()

    def add(self, stamp_ns: int, seq: int, origin: bytes, flags: int, payload: bytes) -> PacketItem:
        """Number a message and keep it."""
        self.number += 1
        item = PacketItem(self.number, stamp_ns, seq, origin, flags, RAW, payload)
        if self._depth:
            self.active = time.monotonic()
            kept = self._kept
            kept.append(item)
            self._kept_bytes += len(item.payload)
            while len(kept) > 1 and (len(kept) > self._depth or self._kept_bytes > _KEEP_BYTES):
                self._kept_bytes -= len(kept.popleft().payload)
        return item

    def sent(self, number: int) -> None:
        """Note that the message with this number, and all before it, went out, or never will."""
        self._sent = max(self._sent, number)

    def tail(self) -> int:
        """Return the newest number that readers should have: it went out a while ago, and not just now."""
        come, coming, since_s = self._tails
        now_s = time.monotonic()
        if now_s - since_s >= _ON_THE_WAY_S:
            come = coming
            self._tails = come, self._sent, now_s
        return come

    def seal(self, items: Sequence[PacketItem]) -> bytes:
        """Seal one packet."""
        plain = b"".join(frame(items))
        with self._lock:
            return self._sealer.seal_framed(plain, len(items))

    def grant(self, reader: Certificate, gateway: bytes = b"", secret: bytes = b"") -> dict[str, Any]:
        """Return the keys for an authorized reader. Raises ``SealError`` for others.

        ``secret`` is that of its ``gateway`` for proofs to it alone, ``b""`` where it wants signatures.
        """
        if not reader.rights.may("subscribe", self.topic) or not self._may(reader):
            raise SealError(Refusal.NO_RIGHT, f"{reader.name} may not read {self.topic}")
        with self._lock:
            self._readers[reader.fingerprint] = reader
            if self._proofs is not None:
                self._proofs.granted(reader.fingerprint, gateway, secret, time.monotonic())
                self._sealer.prove_to(self._proofs.secrets())
            if not self._replay:
                self._first.setdefault(reader.fingerprint, self.number)
            return {"g": self._sealer.grant().to_cbor(), "n": self.number}

    def subscribed(self, readers: Collection[tuple[bytes, bytes]]) -> None:
        """Note which certificates (by fingerprint) and gateways subscribe now, so that those who left are let go of."""
        if self._proofs is not None:
            self._proofs.subscribed(readers)

    def history(self, reader: Certificate, after: int, upto: int | None) -> list[bytes]:
        """Return what is kept of the messages after number ``after``, up to ``upto``. Raises ``SealError``."""
        if reader.fingerprint not in self._readers:
            raise SealError(Refusal.NO_RIGHT, f"{reader.name} has no key of {self.topic}")
        self._expire()
        after = max(after, self._first.get(reader.fingerprint, 0))
        found: list[bytes] = []
        size = 0
        for item in reversed(self._kept):
            if item.number <= after or size > OVERLAY_HISTORY_BYTES:
                break
            if upto is None or item.number <= upto:
                found.append(pack(item))
                size += len(found[-1])
        return found[::-1]

    def _expire(self) -> None:
        if self._lifespan_ns is None:
            return
        oldest = time.time_ns() - self._lifespan_ns
        while self._kept and self._kept[0].stamp_ns < oldest:
            self._kept_bytes -= len(self._kept.popleft().payload)

    def recheck(self, good: Callable[[Certificate], bool]) -> bool:
        """Make new keys where a reader lost its right, and where they have served their time; true if so."""
        with self._lock:
            lost = [mark for mark, reader in self._readers.items() if not good(reader)]
            for mark in lost:
                del self._readers[mark]
                self._first.pop(mark, None)
            self._recheck_proofs(lost)
            if lost:
                self._sealer.renew()
            elif time.monotonic() - self._rotated >= self._rotate_s:
                self._sealer.rotate()
            else:
                return False
            self._rotated = time.monotonic()
            return True

    def _recheck_proofs(self, lost: Sequence[bytes]) -> None:
        """Prove packets to nobody who lost its right or reads no longer; with the lock held."""
        if self._proofs is None:
            return
        for fingerprint in lost:
            self._proofs.lost(fingerprint)
        self._proofs.expire(time.monotonic())
        self._sealer.prove_to(self._proofs.secrets())
