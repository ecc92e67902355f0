"""Notes that members send each other through routers: signed by the sender, readable by members only.

A note is CBOR, bound to its sender and its kind, signed with the gateway's own key and then encrypted. A router sees
its size and its sender's random id. As long as nobody was revoked, all members derive the key from the fleet's name
secret. From the first revocation on, each gateway has a key of its own, which it gives to members in good standing when
they ask, and replaces with every further revocation: a revoked member cannot read later notes. Such a note begins with
``rw-note2`` and the 8 bytes that name its key.
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
from ropeway.networks.overlay.crypto.cbor import loads, pair
from ropeway.networks.overlay.refusal import Refusal

__all__ = ["NoteKey", "Verifier", "note_key_id"]

_NONCE_BYTES: Final = 12
_TAG: Final = b"ropeway note 1\0"
_MAGIC: Final = b"rw-note2"
_ID_BYTES: Final = 8
_KEY_BYTES: Final = 32


class Verifier(Protocol):
    """A certificate, as far as notes need it."""

    def verify_signature(self, message: bytes, signature: bytes) -> bool:
        """Return whether the owner of the certificate signed ``message``."""


class NoteKey:
    """A key for notes: that of a fleet, made of its name secret, or one of a single gateway, with an ``id``."""

    def __init__(self, secret: bytes, id: bytes = b"") -> None:
        self.secret, self.id = secret, id
        self._head = _MAGIC + id if id else b""
        key = HKDF(SHA256(), 32, salt=None, info=_TAG + id).derive(secret)
        self._cipher = AESGCM(key)

    @classmethod
    def fresh(cls) -> NoteKey:
        """Return a key that nobody else has yet."""
        return cls(os.urandom(_KEY_BYTES), os.urandom(_ID_BYTES))

    @classmethod
    def read(cls, secret: object, id: object) -> NoteKey:
        """Return a key that somebody told us. Raises ``SealError``."""
        if type(secret) is not bytes or len(secret) != _KEY_BYTES or type(id) is not bytes or len(id) != _ID_BYTES:
            raise SealError(Refusal.MALFORMED, "a key for notes")
        return cls(secret, id)

    def seal(self, gateway: bytes, kind: str, body: object, sign: Callable[[bytes], bytes]) -> bytes:
        """Return a note of ``kind`` by ``gateway``; ``sign`` is its owner's signature."""
        about = _about(gateway, kind)
        text = cbor2.dumps(body)
        signed = cbor2.dumps((text, sign(hashlib.sha256(about + text).digest())))
        nonce = os.urandom(_NONCE_BYTES)
        return self._head + nonce + self._cipher.encrypt(nonce, signed, about)

    def open(
        self,
        raw: bytes,
        gateway: bytes,
        kind: str,
        shape: Mapping[str, type],
        certify: Callable[[Mapping[str, Any]], Verifier],
    ) -> dict[str, Any]:
        """Open a note and return its map, which has the keys of ``shape``, each with a value of its type.

        ``certify`` gets it and gives the certificate of who must have signed it. Raises ``SealError``, also what
        ``certify`` raises.
        """
        if note_key_id(raw) != self.id:
            raise SealError(Refusal.NO_KEY, f"a note ({kind})")
        raw = raw[len(self._head) :]
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


def note_key_id(raw: bytes) -> bytes:
    """Return which key a note is sealed with, ``b""`` where it is that of the fleet."""
    return raw[len(_MAGIC) :][:_ID_BYTES] if raw.startswith(_MAGIC) else b""


def _about(gateway: bytes, kind: str) -> bytes:
    name = kind.encode()
    return _TAG + bytes([len(gateway)]) + gateway + bytes([len(name)]) + name
