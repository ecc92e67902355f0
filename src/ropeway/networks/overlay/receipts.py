"""Receipts: each gateway acknowledges to those that it reads from how far their packets have come.

The reader makes a key and gives it to the gateway that it reads from, over their sealed channel; a receipt is sealed
with it::

    16 bytes that name the key | counter u64 | ciphertext, tag

It contains the newest number of each lane on which something arrived (``packet_mark``). The next receipt makes up for a
lost one, and a duplicate changes nothing. A gateway that does not know of receipts refuses the key and gets none; to a
reader that gave no key, data is sent without a window.
"""

from __future__ import annotations

import asyncio
import contextlib
import logging
import os
import struct
import time
from collections.abc import Callable, Mapping
from typing import Any, Final

from cryptography.exceptions import InvalidTag
from cryptography.hazmat.primitives.ciphers.aead import AESGCM

from ropeway.delivery.outbox import LANES
from ropeway.errors import RopewayError, SealError
from ropeway.networks.overlay.crypto.certificate import Certificate
from ropeway.networks.overlay.data_plane import DataPlane, Handle
from ropeway.networks.overlay.gateway_path import Path
from ropeway.networks.overlay.packet_mark import Mark
from ropeway.networks.overlay.refusal import Refusal
from ropeway.networks.overlay.rpc import RemoteError, Rpc, part
from ropeway.tasks import Chores

__all__ = ["Receipts"]

log = logging.getLogger("ropeway.overlay")

_OP: Final = "receipts"
_ASK_S: Final = 2.0
_AGAIN_S: Final = 1.0  # it does not know us yet, or did not answer
_RENEW_S: Final = 30.0  # it may have forgotten us; while data comes
_SPACING_S: Final = 0.002  # between two receipts for one gateway
_ID_BYTES: Final = 16
_KEY_BYTES: Final = 32
_HEAD: Final = struct.Struct(">16sQ")
_NEWEST: Final = struct.Struct(">BQ")
_MOST_BYTES: Final = _HEAD.size + LANES * _NEWEST.size + 16


def receipt_key(gateway: bytes) -> str:
    """Return where a gateway takes receipts."""
    return f"rw/k/{gateway.hex()}"


class _Origin:
    """A gateway that we read from, and what came of it."""

    def __init__(self, gateway: bytes) -> None:
        self.gateway = gateway
        self.id, self.secret = os.urandom(_ID_BYTES), os.urandom(_KEY_BYTES)
        self.cipher = AESGCM(self.secret)
        self.counter = 0
        self.newest = [0] * LANES
        self.told = [0] * LANES
        self.told_s = self.asked_s = float("-inf")
        self.known = False  # it takes receipts
        self.scheduled = False


class _Reader:
    """A gateway that reads from us and tells what came."""

    def __init__(self, gateway: bytes, secret: bytes) -> None:
        self.gateway = gateway
        self.cipher = AESGCM(secret)
        self.path = Path()


class Receipts:
    """Tells others what came of theirs, and learns what came of ours: ``paths``, by gateway.

    ``owner`` gives the certificate of a gateway, ``refused`` is told of what is not believed.
    """

    def __init__(
        self,
        fabric: DataPlane,
        rpc: Rpc,
        owner: Callable[[bytes], Certificate | None],
        refused: Callable[[str, SealError], None],
    ) -> None:
        self.paths: dict[bytes, Path] = {}
        self._fabric, self._rpc, self._owner, self._refused = fabric, rpc, owner, refused
        self._origins: dict[bytes, _Origin] = {}
        self._readers: dict[bytes, _Reader] = {}  # by the id of the key
        self._numbers = [0] * LANES
        self._listeners: list[Callable[[], None]] = []
        self._asking = Chores()
        self._end: Handle | None = None
        self._loop: asyncio.AbstractEventLoop

    def open(self) -> None:
        """Take receipts from now on."""
        self._loop = asyncio.get_running_loop()
        self._rpc.answers(_OP, self._introduced)
        self._end = self._fabric.hear(
            receipt_key(self._fabric.gateway), lambda _, raw: self._take(raw), limit_bytes=_MOST_BYTES
        )

    async def close(self) -> None:
        """Take none, and tell none."""
        if self._end is not None:
            self._end()
            self._end = None
        self._origins.clear()
        await self._asking.close()

    def forget(self, gateway: bytes) -> None:
        """Let go of a gateway that has left."""
        self._origins.pop(gateway, None)
        self.paths.pop(gateway, None)
        for id in [id for id, reader in self._readers.items() if reader.gateway == gateway]:
            del self._readers[id]
        self._changed()

    # ── what we send ───────────────────────────────────────────────────────────────────────────────────────────

    def next_number(self, lane: int) -> int:
        """Return the number of the next packet of a lane; in the lane's thread."""
        self._numbers[lane] += 1
        return self._numbers[lane]

    def on_change(self, callback: Callable[[], None]) -> Handle:
        """Call after each receipt, and whenever paths come and go."""
        self._listeners.append(callback)

        def end() -> None:
            with contextlib.suppress(ValueError):
                self._listeners.remove(callback)

        return end

    def _changed(self) -> None:
        for callback in list(self._listeners):
            callback()

    async def _introduced(self, peer: Certificate, request: Mapping[str, Any]) -> Any:
        """Take the key of a gateway that reads from us; false where we do not know it yet."""
        gateway, id, secret = part(request, "by", bytes), part(request, "id", bytes), part(request, "key", bytes)
        if len(id) != _ID_BYTES or len(secret) != _KEY_BYTES:
            raise SealError(Refusal.MALFORMED, "a key for receipts")
        owner = self._owner(gateway)
        if owner is None:
            return False
        if owner.fingerprint != peer.fingerprint:
            raise SealError(Refusal.NO_RIGHT, f"{peer.name} gives receipts for another gateway")
        known = self._readers.get(id)
        if known is None or known.gateway != gateway:
            for old in [old for old, reader in self._readers.items() if reader.gateway == gateway or old == id]:
                del self._readers[old]
            reader = self._readers[id] = _Reader(gateway, secret)
            self.paths[gateway] = reader.path
            self._changed()
        return True

    def _take(self, raw: bytes) -> None:
        if len(raw) < _HEAD.size:
            self._refused("a receipt", SealError(Refusal.TRUNCATED, f"a receipt of {len(raw)} bytes"))
            return
        id, counter = _HEAD.unpack_from(raw)
        reader = self._readers.get(id)
        if reader is None:
            return  # of one that has left, or that we forgot: it tells us its key again
        try:
            body = reader.cipher.decrypt(_nonce(counter), raw[_HEAD.size :], raw[: _HEAD.size])
            newest = list(_NEWEST.iter_unpack(body))
        except InvalidTag:
            self._refused("a receipt", SealError(Refusal.BAD_TAG, "a receipt"))
            return
        except struct.error:
            self._refused("a receipt", SealError(Refusal.MALFORMED, "a receipt"))
            return
        reader.path.acknowledged(newest, time.monotonic())
        self._changed()

    # ── what we read ───────────────────────────────────────────────────────────────────────────────────────────

    def introduce(self, gateway: bytes) -> None:
        """Offer receipts to a gateway that we begin to read from."""
        if self._end is None:
            return
        origin = self._origins.get(gateway)
        if origin is None:
            origin = self._origins[gateway] = _Origin(gateway)
        now_s = self._loop.time()
        if now_s - origin.asked_s >= (_RENEW_S if origin.known else _AGAIN_S):
            origin.asked_s = now_s
            self._asking.start(self._introduce(origin), f"receipts for {gateway.hex()[:8]}")

    async def _introduce(self, origin: _Origin) -> None:
        request = {"op": _OP, "by": self._fabric.gateway, "id": origin.id, "key": origin.secret}
        try:
            origin.known = await self._rpc.ask(origin.gateway, request, _ASK_S) is True
        except RemoteError:
            origin.known = False
            origin.asked_s = self._loop.time() + _RENEW_S  # it knows nothing of receipts
        except RopewayError as error:
            log.debug("overlay: gateway %s takes no receipts yet: %s", origin.gateway.hex()[:8], error)

    def came(self, gateway: bytes, mark: Mark) -> None:
        """Note a packet of another gateway; from any thread."""
        origin = self._origins.get(gateway)
        if origin is None or mark.number <= origin.newest[mark.lane]:
            return
        origin.newest[mark.lane] = mark.number
        if not origin.scheduled:
            origin.scheduled = True
            with contextlib.suppress(RuntimeError):  # the loop has closed
                self._loop.call_soon_threadsafe(self._due, origin)

    def _due(self, origin: _Origin) -> None:
        wait_s = origin.told_s + _SPACING_S - self._loop.time()
        if wait_s > 0:
            self._loop.call_later(wait_s, self._tell, origin)
        else:
            self._tell(origin)

    def _tell(self, origin: _Origin) -> None:
        origin.scheduled = False
        if self._origins.get(origin.gateway) is not origin:
            return
        self.introduce(origin.gateway)
        if not origin.known:
            return
        newest = list(origin.newest)
        lanes = [lane for lane in range(LANES) if newest[lane] != origin.told[lane]]
        if not lanes:
            return
        origin.told, origin.told_s = newest, self._loop.time()
        origin.counter += 1
        head = _HEAD.pack(origin.id, origin.counter)
        body = b"".join(_NEWEST.pack(lane, newest[lane]) for lane in lanes)
        receipt = head + origin.cipher.encrypt(_nonce(origin.counter), body, head)
        self._fabric.tell(receipt_key(origin.gateway), receipt, copies=True)


def _nonce(counter: int) -> bytes:
    return bytes(4) + counter.to_bytes(8, "big")
