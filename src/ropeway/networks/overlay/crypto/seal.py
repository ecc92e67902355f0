"""Seals messages end to end: only holders of the key can read a message, and only its publisher can have made it.

After FogROS2-SGC (thesis, 3.3: AES, SHA-256, RSASSA-PSS), and beyond it: AES-256-GCM under a key per publisher and
epoch, then a signature over the SHA-256 of what was encrypted, so that a member who may read cannot forge. A packet
carries one message or a batch::

    0x52 | version 1 | flags | 0 | epoch u32 | first counter u64 | count u16 | proof length u16
    ciphertext, tag | proof

The proof is the signature (flag 1), or a proof to each reader alone where all of them agreed to that (flag 2, see
``ropeway.networks.overlay.crypto.session_proof``).

All integers are big-endian. The nonce is epoch and first counter, which a publisher never gives twice under one key;
the associated data are the global name, the publisher and the head. A key is replaced long before its bounds: by time,
and at 2**31 packets. Inside the ciphertext each message stands behind its length (u32).
"""

from __future__ import annotations

import hashlib
import os
import struct
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any, Final, NamedTuple

import cbor2  # for what we make; others' is read by ropeway.networks.overlay.crypto.cbor
from cryptography.exceptions import InvalidTag
from cryptography.hazmat.primitives.ciphers.aead import AESGCM

from ropeway.errors import SealError
from ropeway.limits import OVERLAY_MESSAGES_PER_PACKET
from ropeway.networks.overlay.crypto.cbor import loads
from ropeway.networks.overlay.crypto.replay_window import ReplayWindow
from ropeway.networks.overlay.crypto.session_proof import PROOF_BYTES, SessionKey, prove
from ropeway.networks.overlay.refusal import Refusal

__all__ = ["ContentKey", "Grant", "Opened", "Opener", "PacketHeader", "Sealer", "check_signature", "peek"]

_HEAD: Final = struct.Struct(">BBBBIQHH")
_MAGIC: Final = 0x52
_VERSION: Final = 1
_SIGNED: Final = 1
_SESSION: Final = 2
_TAG_BYTES: Final = 16
_KEY_BYTES: Final = 32
_LENGTH: Final = struct.Struct(">I")
_NONCE: Final = struct.Struct(">IQ")
_SIGNATURE_TAG: Final = b"ropeway message 1\0"
_PACKETS: Final = 1 << 31  # under one key
_KEYS: Final = 4  # that a reader keeps: the one before, the current, the next, and one to spare


class PacketHeader(NamedTuple):
    """The head of a packet."""

    epoch: int
    first: int
    messages: int
    proof_bytes: int
    signed: bool
    session: bool


def peek(packet: bytes) -> PacketHeader:
    """Return the head of a packet, not checked yet. Raises ``SealError``: TRUNCATED or MALFORMED."""
    if len(packet) < _HEAD.size + _TAG_BYTES:
        raise SealError(Refusal.TRUNCATED, f"a packet of {len(packet)} bytes")
    magic, version, flags, zero, epoch, first, count, proof_bytes = _HEAD.unpack_from(packet)
    if magic != _MAGIC or version != _VERSION or flags > _SESSION or zero or not count or not first:
        raise SealError(Refusal.MALFORMED, "the head of a packet")
    if flags == _SESSION and (not proof_bytes or proof_bytes % PROOF_BYTES):
        raise SealError(Refusal.MALFORMED, "the proofs of a packet")
    if count > OVERLAY_MESSAGES_PER_PACKET:
        raise SealError(Refusal.TOO_BIG, f"a packet of {count} messages; it may have {OVERLAY_MESSAGES_PER_PACKET}")
    if len(packet) < _HEAD.size + _TAG_BYTES + proof_bytes:
        raise SealError(Refusal.TRUNCATED, f"a packet of {len(packet)} bytes")
    return PacketHeader(epoch, first, count, proof_bytes, flags == _SIGNED, flags == _SESSION)


@dataclass(frozen=True, slots=True)
class ContentKey:
    """The key that encrypts a publisher's messages of one epoch."""

    epoch: int
    secret: bytes


@dataclass(frozen=True, slots=True)
class Grant:
    """Holds what a reader is given: the key in use, the one after it, and the number of the newest message."""

    current: ContentKey
    next: ContentKey
    counter: int

    def to_cbor(self) -> bytes:
        """Return the grant as CBOR, to be sent over a sealed channel."""
        keys = ((key.epoch, key.secret) for key in (self.current, self.next))
        return cbor2.dumps([*keys, self.counter])

    @classmethod
    def from_cbor(cls, raw: bytes) -> Grant:
        """Read it. Raises ``SealError``."""
        try:
            first, second, counter = loads(raw, "a grant")
            keys = [ContentKey(_int(epoch, 32), _secret(secret)) for epoch, secret in (first, second)]
            return cls(keys[0], keys[1], _int(counter, 64))
        except (ValueError, TypeError) as error:
            raise SealError(Refusal.MALFORMED, "a grant") from error


def _int(value: Any, bits: int) -> int:
    if type(value) is not int or not 0 <= value < 1 << bits:
        raise ValueError("no such number")
    return value


def _secret(value: Any) -> bytes:
    if type(value) is not bytes or len(value) != _KEY_BYTES:
        raise ValueError("no key")
    return value


class Sealer:
    """Seals what one publisher has: ``name`` is its global name, ``publisher`` its own 16 bytes.

    ``sign`` is the publisher's signature; ``None`` leaves packets unsigned, which readers refuse unless told otherwise
    (for measurements). ``prove_to`` has packets proven to each reader in place of that. Not thread-safe.
    """

    def __init__(self, name: bytes, publisher: bytes, sign: Callable[[bytes], bytes] | None) -> None:
        self.counter = 0
        self._about = name + publisher
        self._sign = sign
        self._signature_bytes = 0 if sign is None else len(sign(b""))  # Ed25519 64, RSA as long as its key
        self._epoch = int.from_bytes(os.urandom(3), "big")  # another after every start
        self._current, self._next = self._fresh(), self._fresh()
        self._cipher = AESGCM(self._current.secret)
        self._packets = 0
        self._secrets: tuple[bytes, ...] = ()
        self._sessions: list[SessionKey] = []

    @property
    def epoch(self) -> int:
        """The epoch in use."""
        return self._current.epoch

    def _fresh(self) -> ContentKey:
        self._epoch = self._epoch + 1 & 0xFFFFFFFF
        return ContentKey(self._epoch, os.urandom(_KEY_BYTES))

    def rotate(self) -> None:
        """Use the next key, which readers have already, and make one to follow it."""
        self._use(self._next, self._fresh())

    def renew(self) -> None:
        """Use a key that nobody has yet: somebody lost the right to read."""
        self._use(self._fresh(), self._fresh())

    def _use(self, current: ContentKey, following: ContentKey) -> None:
        self._current, self._next = current, following
        self._cipher = AESGCM(current.secret)
        self._packets = 0
        self._sessions = [SessionKey(secret, self._about, current.epoch) for secret in self._secrets]

    def prove_to(self, secrets: Sequence[bytes]) -> None:
        """Prove packets to the readers with these secrets, and to nobody else; with none, sign them."""
        if self._secrets != tuple(secrets):
            self._secrets = tuple(secrets)
            self._sessions = [SessionKey(secret, self._about, self.epoch) for secret in secrets]

    def grant(self) -> Grant:
        """Return what to hand to an authorized reader."""
        return Grant(self._current, self._next, self.counter)

    def seal(self, items: Sequence[Sequence[bytes]]) -> bytes:
        """Seal one packet with these messages, 1 to 65,535 of them, each in as many pieces as it comes in."""
        plain = b"".join(part for item in items for part in (_LENGTH.pack(sum(map(len, item))), *item))
        return self.seal_framed(plain, len(items))

    def seal_framed(self, plain: bytes, count: int) -> bytes:
        """Seal one packet with so many messages, each of which stands behind its length."""
        if self._packets >= _PACKETS:
            self.rotate()
        self._packets += 1
        first, self.counter = self.counter + 1, self.counter + count
        epoch, sessions = self._current.epoch, self._sessions
        if sessions:
            flags, proof_bytes = _SESSION, len(sessions) * PROOF_BYTES
        else:
            flags, proof_bytes = 0 if self._sign is None else _SIGNED, self._signature_bytes
        head = _HEAD.pack(_MAGIC, _VERSION, flags, 0, epoch, first, count, proof_bytes)
        about, nonce = self._about + head, _NONCE.pack(epoch, first)
        sealed = self._cipher.encrypt(nonce, plain, about)
        if sessions:
            packet = head + sealed
            return b"".join((packet, *prove(sessions, nonce, packet)))
        if self._sign is None:
            return head + sealed
        return b"".join((head, sealed, self._sign(_digest(about, sealed))))


def _digest(about: bytes, sealed: bytes | memoryview) -> bytes:
    digest = hashlib.sha256(_SIGNATURE_TAG)
    digest.update(about)
    digest.update(sealed)
    return digest.digest()


def check_signature(
    packet: bytes, name: bytes, publisher: bytes, verify: Callable[[bytes, bytes], bool]
) -> PacketHeader:
    """Return the head of a packet that its publisher signed, without a key to read it. Raises ``SealError``."""
    head = peek(packet)
    end = len(packet) - head.proof_bytes
    view = memoryview(packet)
    if head.session:
        raise SealError(Refusal.BAD_SIGNATURE, "it has none: its publisher proves packets to their readers alone")
    if not head.signed:
        raise SealError(Refusal.BAD_SIGNATURE, "it has none")
    if not verify(_digest(name + publisher + packet[: _HEAD.size], view[_HEAD.size : end]), bytes(view[end:])):
        raise SealError(Refusal.BAD_SIGNATURE, f"message {head.first}")
    return head


class Opened(NamedTuple):
    """The content of a packet, with the ends of its messages; ``first`` is the counter of the first one."""

    first: int
    plain: bytes
    spans: list[tuple[int, int]]
    epoch: int

    @property
    def items(self) -> list[memoryview]:
        """The messages."""
        view = memoryview(self.plain)
        return [view[at:end] for at, end in self.spans]


class Opener:
    """Opens what one publisher sealed. ``verify(message, signature)`` is its certificate's. Not thread-safe.

    With ``secret``, which only the publisher was given, packets that it proves to us are believed as signed ones are. A
    packet that is refused changes nothing.
    """

    def __init__(
        self,
        name: bytes,
        publisher: bytes,
        verify: Callable[[bytes, bytes], bool],
        *,
        secret: bytes = b"",
        unsigned: bool = False,
    ) -> None:
        self._about = name + publisher
        self._verify = verify
        self._unsigned = unsigned
        self._secret = secret
        self._sessions: dict[int, SessionKey] = {}  # by epoch, of those whose key is here
        self._keys: dict[int, tuple[bytes, AESGCM]] = {}
        self._window: ReplayWindow | None = None

    def add(self, grant: Grant) -> None:
        """Take the keys. The first grant says where the publisher is: what is older is a replay."""
        if self._window is None:
            self._window = ReplayWindow(grant.counter + 1)
        for key in (grant.current, grant.next):
            known = self._keys.get(key.epoch)
            if known is None or known[0] != key.secret:
                self._keys[key.epoch] = (key.secret, AESGCM(key.secret))
        while len(self._keys) > _KEYS:
            oldest = next(iter(self._keys))
            del self._keys[oldest]
            self._sessions.pop(oldest, None)

    @property
    def floor(self) -> int:
        """Return the smallest number that is not too old for ever; 1 while there is no key."""
        return 1 if self._window is None else self._window.floor

    def knows(self, packet: bytes) -> bool:
        """Return whether the key of a packet is here. Raises ``SealError`` for what is no packet."""
        return peek(packet).epoch in self._keys

    def open(self, packet: bytes) -> Opened:
        """Return the messages of a packet. Raises ``SealError``."""
        head = peek(packet)
        key = self._keys.get(head.epoch)
        if key is None or self._window is None:
            raise SealError(Refusal.NO_KEY, f"epoch {head.epoch}")
        refusal = self._window.judge(head.first, head.messages)
        if refusal is not None:
            raise SealError(refusal, f"message {head.first}")
        end = len(packet) - head.proof_bytes
        view = memoryview(packet)
        sealed, about = view[_HEAD.size : end], self._about + packet[: _HEAD.size]
        nonce = _NONCE.pack(head.epoch, head.first)
        if head.session:
            self._check_session(head, nonce, view[:end], view[end:])
        elif not head.signed:
            if not self._unsigned:
                raise SealError(Refusal.BAD_SIGNATURE, "it has none")
        elif not self._verify(_digest(about, sealed), bytes(view[end:])):
            raise SealError(Refusal.BAD_SIGNATURE, f"message {head.first}")
        try:
            plain = key[1].decrypt(nonce, sealed, about)
        except InvalidTag:
            raise SealError(Refusal.BAD_TAG, f"message {head.first}") from None
        spans = _spans(plain, head.messages)
        self._window.take(head.first, head.messages)
        return Opened(head.first, plain, spans, head.epoch)

    def _check_session(self, head: PacketHeader, nonce: bytes, sealed: memoryview, proofs: memoryview) -> None:
        """Check that the publisher proves a packet to us. Raises ``SealError``."""
        if not self._secret:
            raise SealError(Refusal.BAD_SIGNATURE, "it has none, and we agreed to nothing else")
        session = self._sessions.get(head.epoch)
        if session is None:
            session = self._sessions[head.epoch] = SessionKey(self._secret, self._about, head.epoch)
        tag = session.among(proofs)
        if tag is None:
            raise SealError(Refusal.UNPROVEN, f"message {head.first}")
        if not session.holds(nonce, sealed, tag):
            raise SealError(Refusal.BAD_SIGNATURE, f"message {head.first}, whose proof is not its publisher's")


def _spans(plain: bytes, count: int) -> list[tuple[int, int]]:
    """Return where each of ``count`` messages begins and ends. Raises ``SealError`` unless they are all there is."""
    spans: list[tuple[int, int]] = []
    end, size, length_at = 0, len(plain), _LENGTH.unpack_from
    for _ in range(count):
        at = end + _LENGTH.size
        if at > size:
            raise SealError(Refusal.MALFORMED, "a batch")
        end = at + length_at(plain, end)[0]
        if end > size:
            raise SealError(Refusal.MALFORMED, "a batch")
        spans.append((at, end))
    if end != size:
        raise SealError(Refusal.MALFORMED, "a batch")
    return spans
