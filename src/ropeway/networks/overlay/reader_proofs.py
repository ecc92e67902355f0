"""Decides how a publisher proves its packets: to each reader alone while all of them agree to that, else by signature.

A reader that agrees gives a secret with each request for keys, which travels in the sealed channel of the two, so that
nobody between them can add, drop or replace it. A reader that gives none, because its configuration asks for signatures
or its version knows nothing else, has everything signed for as long as it reads.
"""

from __future__ import annotations

from collections.abc import Collection, Mapping
from typing import Any, Final, NamedTuple

from ropeway.errors import SealError
from ropeway.limits import OVERLAY_GATEWAYS_PER_MEMBER, OVERLAY_SESSION_READERS
from ropeway.networks.overlay.crypto.session_proof import SECRET_BYTES
from ropeway.networks.overlay.refusal import Refusal

__all__ = ["ReaderProofs", "offered"]

_LEFT_S: Final = 10.0  # after its last request for keys: by then its subscription was heard of, if it has one
_GATEWAY_BYTES: Final = 16
_FINGERPRINT_BYTES: Final = 32


def offered(request: Mapping[str, Any]) -> tuple[bytes, bytes]:
    """Return the gateway that asks for keys and the secret that it gives, both ``b""`` where it gives none.

    Raises ``SealError``.
    """
    if "session" not in request:
        return b"", b""
    gateway, secret = request.get("by"), request["session"]
    if type(gateway) is not bytes or type(secret) is not bytes:
        raise SealError(Refusal.MALFORMED, "a session")
    if len(gateway) != _GATEWAY_BYTES or len(secret) != SECRET_BYTES:
        raise SealError(Refusal.MALFORMED, "a session")
    return gateway, secret


class _Reader(NamedTuple):
    secret: bytes  # b"" for one that wants signatures
    asked_s: float


class ReaderProofs:
    """Tracks who reads from one publisher.

    A reader is its certificate's fingerprint and its gateway's id: several gateways may have one certificate, and no
    member can speak for another's.
    """

    def __init__(self) -> None:
        self._readers: dict[bytes, _Reader] = {}
        self._subscribed: Collection[bytes] = ()

    def granted(self, fingerprint: bytes, gateway: bytes, secret: bytes, now_s: float) -> None:
        """Note that a reader has the keys; ``gateway`` and ``secret`` are ``b""`` where it wants signatures."""
        mark = fingerprint + gateway
        self._readers.pop(mark, None)
        self._readers[mark] = _Reader(secret, now_s)
        same = [other for other in self._readers if other[:_FINGERPRINT_BYTES] == fingerprint]
        if len(same) > OVERLAY_GATEWAYS_PER_MEMBER:
            del self._readers[same[0]]

    def subscribed(self, readers: Collection[tuple[bytes, bytes]]) -> None:
        """Note which certificates and gateways have subscriptions now."""
        marks = {fingerprint + gateway for fingerprint, gateway in readers}
        self._subscribed = marks | {fingerprint for fingerprint, _ in readers}

    def expire(self, now_s: float) -> None:
        """Forget those that have no subscription any more."""
        for mark, reader in list(self._readers.items()):
            if mark not in self._subscribed and now_s - reader.asked_s > _LEFT_S:
                del self._readers[mark]

    def lost(self, fingerprint: bytes) -> None:
        """Forget a certificate that may read no longer."""
        for mark in [mark for mark in self._readers if mark[:_FINGERPRINT_BYTES] == fingerprint]:
            del self._readers[mark]

    def secrets(self) -> tuple[bytes, ...]:
        """Return the secrets of all readers to prove packets to, empty where they are to be signed."""
        found = tuple(reader.secret for reader in self._readers.values())
        return found if len(found) <= OVERLAY_SESSION_READERS and all(found) else ()
