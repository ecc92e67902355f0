"""A sealed channel between two gateways: requests and answers that only the two can read or make. Sans-I/O.

Each side makes an X25519 key for this channel alone and signs, with the key of its certificate, everything that both
have said so far; the two AES-256-GCM keys, one per direction, come from the shared secret and that transcript. So a
router in between learns nothing, cannot join two conversations, and what it recorded stays sealed when a
certificate's key is lost later. A packet is ``channel id 16 | counter u64 | ciphertext, tag``; a counter never comes
twice.
"""

from __future__ import annotations

import hashlib
import os
import struct
import time
from typing import Any, Final

import cbor2
from cryptography.exceptions import InvalidTag
from cryptography.hazmat.primitives.asymmetric.x25519 import X25519PrivateKey, X25519PublicKey
from cryptography.hazmat.primitives.ciphers.aead import AESGCM
from cryptography.hazmat.primitives.hashes import SHA256
from cryptography.hazmat.primitives.kdf.hkdf import HKDF
from cryptography.hazmat.primitives.serialization import Encoding, PublicFormat

from ropeway.errors import SealError
from ropeway.networks.overlay.crypto.cbor import loads, pair
from ropeway.networks.overlay.crypto.certificate import Certificate
from ropeway.networks.overlay.crypto.identity import Identity
from ropeway.networks.overlay.crypto.replay_window import ReplayWindow
from ropeway.networks.overlay.crypto.trust import Trust
from ropeway.networks.overlay.refusal import Refusal

__all__ = ["Initiator", "SecureChannel", "peek_channel", "respond"]

_ID_BYTES: Final = 16
_HEAD: Final = struct.Struct(">16sQ")
_HELLO_TAG: Final = b"ropeway hello 1\0"
_REPLY_TAG: Final = b"ropeway hello reply 1\0"
_KEYS_TAG: Final = b"ropeway channel 1\0"
_LIFE_S: Final = 600.0
_PACKETS: Final = 1 << 31


class SecureChannel:
    """Seals and opens packets on one side of an open channel. ``peer`` is the other side's certificate."""

    def __init__(self, id: bytes, peer: Certificate, out: bytes, into: bytes) -> None:
        self.id, self.peer = id, peer
        self._out, self._in = AESGCM(out), AESGCM(into)
        self._counter = 0
        self._window = ReplayWindow()
        self._ends = time.monotonic() + _LIFE_S

    def usable(self) -> bool:
        """Return whether the channel is within its ten minutes and its number of packets."""
        return time.monotonic() < self._ends and self._counter < _PACKETS

    def seal(self, plaintext: bytes, about: bytes = b"") -> bytes:
        """Seal a packet; ``about`` has to be the same on the other side."""
        self._counter += 1
        head = _HEAD.pack(self.id, self._counter)
        return head + self._out.encrypt(_nonce(self._counter), plaintext, head + about)

    def open(self, packet: bytes, about: bytes = b"") -> bytes:
        """Open a packet and return its content. Raises ``SealError``."""
        if len(packet) < _HEAD.size + 16:
            raise SealError(Refusal.TRUNCATED, f"a packet of {len(packet)} bytes")
        id, counter = _HEAD.unpack_from(packet)
        if id != self.id:
            raise SealError(Refusal.WRONG_NAME, "a packet of another channel")
        refusal = self._window.judge(counter)
        if refusal is not None:
            raise SealError(refusal, f"packet {counter} of a channel")
        view = memoryview(packet)
        try:
            plain = self._in.decrypt(_nonce(counter), view[_HEAD.size :], packet[: _HEAD.size] + about)
        except InvalidTag:
            raise SealError(Refusal.BAD_TAG, f"packet {counter} of a channel") from None
        self._window.take(counter)
        return plain


def peek_channel(packet: bytes) -> bytes:
    """Return which channel a packet belongs to. Raises ``SealError``."""
    if len(packet) < _HEAD.size:
        raise SealError(Refusal.TRUNCATED, f"a packet of {len(packet)} bytes")
    return bytes(packet[:_ID_BYTES])


class Initiator:
    """Begins a channel to the gateway with the id ``target``: send ``hello``, then ``finish`` with the reply."""

    def __init__(self, identity: Identity, target: bytes) -> None:
        self._target = target
        self._own = X25519PrivateKey.generate()
        body = cbor2.dumps((identity.certificate.der, _public(self._own), os.urandom(16)))
        self.hello = cbor2.dumps((body, identity.sign(_hash(_HELLO_TAG, target, body))))

    def finish(self, reply: bytes, trust: Trust) -> SecureChannel:
        """Check the reply and return the channel.

        Raises ``SealError`` where the reply is not from who we asked, or not to be believed.
        """
        body, signature = pair(reply, "a greeting")
        fields = loads(body, "a greeting")
        _expect(fields, (bytes, bytes, bytes, bytes))
        der, public, id, target = fields
        peer = trust.check(der)
        if target != self._target or len(id) != _ID_BYTES:
            raise SealError(Refusal.WRONG_NAME, f"a reply of {peer.name}")
        if not peer.verify_signature(_hash(_REPLY_TAG, self.hello, body), signature):
            raise SealError(Refusal.BAD_SIGNATURE, f"a reply of {peer.name}")
        out, into = _keys(self._own, public, self.hello, body)
        return SecureChannel(id, peer, out, into)


def respond(identity: Identity, own: bytes, hello: bytes, trust: Trust) -> tuple[bytes, SecureChannel]:
    """Answer a hello that was sent to us (gateway id ``own``); return the reply and the channel.

    Raises ``SealError``.
    """
    body, signature = pair(hello, "a greeting")
    fields = loads(body, "a greeting")
    _expect(fields, (bytes, bytes, bytes))
    der, public, _ = fields
    peer = trust.check(der)
    if not peer.verify_signature(_hash(_HELLO_TAG, own, body), signature):
        raise SealError(Refusal.BAD_SIGNATURE, f"a hello of {peer.name}, or one to another gateway")
    mine = X25519PrivateKey.generate()
    id = os.urandom(_ID_BYTES)
    answer = cbor2.dumps((identity.certificate.der, _public(mine), id, own))
    reply = cbor2.dumps((answer, identity.sign(_hash(_REPLY_TAG, hello, answer))))
    into, out = _keys(mine, public, hello, answer)
    return reply, SecureChannel(id, peer, out, into)


def _keys(own: X25519PrivateKey, public: bytes, hello: bytes, answer: bytes) -> tuple[bytes, bytes]:
    """Return the keys from the initiator, and to it."""
    try:
        shared = own.exchange(X25519PublicKey.from_public_bytes(public))
    except ValueError as error:  # also the points of small order
        raise SealError(Refusal.MALFORMED, "a key") from error
    salt = _hash(_KEYS_TAG, hello, answer)
    both = HKDF(SHA256(), 64, salt=salt, info=_KEYS_TAG).derive(shared)
    return both[:32], both[32:]


def _public(key: X25519PrivateKey) -> bytes:
    return key.public_key().public_bytes(Encoding.Raw, PublicFormat.Raw)


def _hash(tag: bytes, *parts: bytes) -> bytes:
    digest = hashlib.sha256(tag)
    for part in parts:
        digest.update(struct.pack(">I", len(part)) + part)
    return digest.digest()


def _nonce(counter: int) -> bytes:
    return bytes(4) + counter.to_bytes(8, "big")


def _expect(fields: Any, kinds: tuple[type, ...]) -> None:
    fits = isinstance(fields, (list, tuple)) and len(fields) == len(kinds)
    if not fits or any(type(field) is not kind for field, kind in zip(fields, kinds, strict=True)):
        raise SealError(Refusal.MALFORMED, "a greeting")
