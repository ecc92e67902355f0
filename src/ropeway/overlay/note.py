"""Notes that members tell each other through routers: signed by who tells, readable by members only.

A note is CBOR, bound to the gateway that tells it and to what kind of note it is, signed with the gateway's own key and
then encrypted under a key that all members derive from the fleet's name secret. A router sees its size and its sender's
random id.
"""

from __future__ import annotations

import hashlib
import os
from collections.abc import Callable, Mapping
from typing import Any, Final, Protocol

import cbor2
from cryptography.exceptions import InvalidTag
from cryptography.hazmat.primitives.ciphers.aead import AESGCM
from cryptography.hazmat.primitives.hashes import SHA256
from cryptography.hazmat.primitives.kdf.hkdf import HKDF

from ropeway.errors import SealError
from ropeway.limits import OVERLAY_NOTE_BYTES
from ropeway.overlay.cbor import loads, pair
from ropeway.overlay.refusal import Refusal

__all__ = ["NoteKey", "Verifier"]

_NONCE_BYTES: Final = 12
_TAG: Final = b"ropeway note 1\0"


class Verifier(Protocol):
    """A certificate, as far as notes need it."""

    def verify_signature(self, message: bytes, signature: bytes) -> bool:
        """True if the owner of the certificate signed ``message``."""


class NoteKey:
    """The key under which the members of one fleet tell each other notes."""

    def __init__(self, name_secret: bytes) -> None:
        key = HKDF(SHA256(), 32, salt=None, info=_TAG).derive(name_secret)
        self._cipher = AESGCM(key)

    def seal(self, gateway: bytes, kind: str, body: object, sign: Callable[[bytes], bytes]) -> bytes:
        """A note of ``kind`` that ``gateway`` tells; ``sign`` is its owner's signature."""
        about = _about(gateway, kind)
        text = cbor2.dumps(body)
        signed = cbor2.dumps((text, sign(hashlib.sha256(about + text).digest())))
        nonce = os.urandom(_NONCE_BYTES)
        return nonce + self._cipher.encrypt(nonce, signed, about)

    def open(
        self,
        raw: bytes,
        gateway: bytes,
        kind: str,
        shape: Mapping[str, type],
        certify: Callable[[Mapping[str, Any]], Verifier],
    ) -> dict[str, Any]:
        """What a note says: a map that has the keys of ``shape``, each with a value of its type.

        ``certify`` gets it and gives the certificate of who must have signed it. Raises ``SealError``, also what
        ``certify`` raises.
        """
        if len(raw) < _NONCE_BYTES + 16:
            raise SealError(Refusal.TRUNCATED, f"a note of {len(raw)} bytes")
        if len(raw) > OVERLAY_NOTE_BYTES:
            raise SealError(Refusal.TOO_BIG, f"a note of {len(raw)} bytes")
        about = _about(gateway, kind)
        try:
            signed = self._cipher.decrypt(raw[:_NONCE_BYTES], raw[_NONCE_BYTES:], about)
        except InvalidTag:
            raise SealError(Refusal.BAD_TAG, f"a note ({kind})") from None
        text, signature = pair(signed, f"a note ({kind})")
        body = loads(text, f"a note ({kind})")
        if not isinstance(body, dict) or any(type(body.get(key)) is not kind for key, kind in shape.items()):
            raise SealError(Refusal.MALFORMED, f"a note ({kind})")
        if not certify(body).verify_signature(hashlib.sha256(about + text).digest(), signature):
            raise SealError(Refusal.BAD_SIGNATURE, f"a note ({kind})")
        found: dict[str, Any] = body
        return found


def _about(gateway: bytes, kind: str) -> bytes:
    name = kind.encode()
    return _TAG + bytes([len(gateway)]) + gateway + bytes([len(name)]) + name
