"""Proves packets to readers that share a secret with their publisher, one by one, in place of a signature.

The reader makes the secret and gives it to the publisher over their sealed channel, so nobody else has it. For each
epoch both derive a key and an id from it; the proof is GMAC (AES-256-GCM over nothing, with the packet as what goes
with it) under the nonce of the packet, which never comes twice under one key. Another reader has another secret, so
it can forge nothing. What is given up: whoever else is shown a packet cannot tell which of the two made it.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from typing import Final

from cryptography.exceptions import InvalidTag
from cryptography.hazmat.primitives.ciphers.aead import AESGCM
from cryptography.hazmat.primitives.hashes import SHA256
from cryptography.hazmat.primitives.kdf.hkdf import HKDF

__all__ = ["PROOF_BYTES", "SECRET_BYTES", "SessionKey", "prove"]

SECRET_BYTES: Final = 32
_ID_BYTES: Final = 8
_KEY_BYTES: Final = 32
_TAG_BYTES: Final = 16
PROOF_BYTES: Final = _ID_BYTES + _TAG_BYTES
_TAG: Final = b"ropeway session 1\0"


class SessionKey:
    """The key between a publisher and one reader for one epoch; ``about`` is the global name and the publisher."""

    __slots__ = ("_cipher", "id")

    def __init__(self, secret: bytes, about: bytes, epoch: int) -> None:
        info = _TAG + about + epoch.to_bytes(4, "big")
        derived = HKDF(SHA256(), _ID_BYTES + _KEY_BYTES, salt=None, info=info).derive(secret)
        self.id = derived[:_ID_BYTES]
        self._cipher = AESGCM(derived[_ID_BYTES:])

    def prove(self, nonce: bytes, sealed: bytes) -> bytes:
        """Return the proof of a packet: the id, so that the reader finds it among those for others, and the tag."""
        return self.id + self._cipher.encrypt(nonce, b"", sealed)

    def among(self, proofs: memoryview) -> bytes | None:
        """Return the tag that is for this reader, ``None`` where there is none."""
        for at in range(0, len(proofs), PROOF_BYTES):
            if proofs[at : at + _ID_BYTES] == self.id:
                return bytes(proofs[at + _ID_BYTES : at + PROOF_BYTES])
        return None

    def holds(self, nonce: bytes, sealed: memoryview, tag: bytes) -> bool:
        """Return whether a tag proves that the publisher made a packet."""
        try:
            self._cipher.decrypt(nonce, tag, sealed)
        except InvalidTag:
            return False
        return True


def prove(keys: Iterable[SessionKey], nonce: bytes, sealed: bytes) -> Sequence[bytes]:
    """Return the proofs of a packet for several readers."""
    return [key.prove(nonce, sealed) for key in keys]
