"""Advertisements: what a gateway has, signed by it and readable by members only. Sans-I/O."""

from __future__ import annotations

import hashlib
import os
import time
from dataclasses import astuple, dataclass
from typing import Any, Final

import cbor2
from cryptography.exceptions import InvalidTag
from cryptography.hazmat.primitives.ciphers.aead import AESGCM
from cryptography.hazmat.primitives.hashes import SHA256
from cryptography.hazmat.primitives.kdf.hkdf import HKDF

from ropeway.errors import SealError
from ropeway.limits import NAME_CHARACTERS, OVERLAY_METADATA_CHARACTERS
from ropeway.networks.overlay.crypto.cbor import loads, pair
from ropeway.networks.overlay.crypto.certificate import Certificate
from ropeway.networks.overlay.crypto.identity import Identity
from ropeway.networks.overlay.names import NAME_BYTES, Metadata, global_name
from ropeway.networks.overlay.refusal import Refusal
from ropeway.qos import QoS

__all__ = ["VERB_OF", "Advertisement", "advert_key", "make_advert", "read_advert"]

VERB_OF: Final = {"publisher": "publish", "subscription": "subscribe", "service": "offer", "client": "call"}
"""The right that each kind needs."""

_TAG: Final = b"ropeway advertisement 1\0"
_NONCE_BYTES: Final = 12


@dataclass(frozen=True, slots=True)
class Advertisement:
    """An endpoint of a gateway.

    ``kind``: ``publisher``, ``subscription``, ``service`` or ``client``; ``global_name`` 32 bytes, ``endpoint`` and
    ``gateway`` 16; ``name`` and ``type`` those of ROS; ``qos`` ``None`` for services and for readers that take what is
    offered; ``since_ns`` and ``expires_ns`` are times (``time.time_ns``).

    Three things are told beside the advertisement: ``node``, the name of the node that has it, for people; ``target``,
    the gateway that it is for, ``b""`` for all; and ``answers``, the topic on which the target answers what is
    published, ``""`` for none. What a publisher with a target sends goes to that gateway alone.
    """

    kind: str
    global_name: bytes
    endpoint: bytes
    gateway: bytes
    name: str
    type: str
    qos: QoS | None
    encoding: str
    metadata: Metadata
    since_ns: int
    expires_ns: int
    node: str = ""
    target: bytes = b""
    answers: str = ""


def advert_key(name_secret: bytes) -> AESGCM:
    """Derive the key with which the members of a fleet read advertisements."""
    return AESGCM(HKDF(SHA256(), 32, salt=None, info=_TAG).derive(name_secret))


def make_advert(advert: Advertisement, identity: Identity, key: AESGCM) -> bytes:
    """Make an advertisement for others, signed and encrypted."""
    qos = advert.qos
    body = cbor2.dumps(
        (
            advert.kind,
            advert.global_name,
            advert.endpoint,
            advert.name,
            advert.type,
            None if qos is None else list(astuple(qos)),
            advert.encoding,
            list(advert.metadata.fields()),
            advert.since_ns,
            advert.expires_ns,
        )
    )
    signed = cbor2.dumps((body, identity.sign(_digest(advert.gateway, body))))
    nonce = os.urandom(_NONCE_BYTES)
    return nonce + key.encrypt(nonce, signed, _TAG + advert.gateway)


def read_advert(
    raw: bytes, gateway: bytes, certificate: Certificate, key: AESGCM, secret: bytes, now_ns: int | None = None
) -> Advertisement:
    """Open and verify an advertisement said to be made by ``gateway``, whose owner has ``certificate``.

    Raises ``SealError``: TRUNCATED, BAD_TAG, MALFORMED, BAD_SIGNATURE, EXPIRED, WRONG_NAME (its global name is not
    that of what it says it is) or NO_RIGHT.
    """
    if type(raw) is not bytes or len(raw) < _NONCE_BYTES + 16:
        raise SealError(Refusal.TRUNCATED, "an advertisement")
    try:
        signed = key.decrypt(raw[:_NONCE_BYTES], raw[_NONCE_BYTES:], _TAG + gateway)
    except InvalidTag:
        raise SealError(Refusal.BAD_TAG, "an advertisement") from None
    body, signature = pair(signed, "an advertisement")
    fields = loads(body, "an advertisement")
    try:
        advert = _parse(fields, gateway)
    except (ValueError, TypeError, OverflowError) as error:
        raise SealError(Refusal.MALFORMED, "an advertisement") from error
    if not certificate.verify_signature(_digest(gateway, body), signature):
        raise SealError(Refusal.BAD_SIGNATURE, f"an advertisement of {advert.name}")
    if advert.expires_ns < (time.time_ns() if now_ns is None else now_ns):
        raise SealError(Refusal.EXPIRED, f"an advertisement of {advert.name}")
    kind = "topic" if advert.kind in ("publisher", "subscription") else "service"
    if advert.global_name != global_name(secret, kind, advert.name, advert.type, advert.metadata):
        raise SealError(Refusal.WRONG_NAME, f"an advertisement of {advert.name}")
    verb = VERB_OF[advert.kind]
    if not certificate.rights.may(verb, advert.name):
        raise SealError(Refusal.NO_RIGHT, f"{certificate.name} may not {verb} {advert.name}")
    return advert


def _parse(fields: Any, gateway: bytes) -> Advertisement:
    kind, name_bytes, endpoint, name, type_, qos, encoding, metadata, since_ns, expires_ns = fields
    texts = (kind, name, type_, encoding, *metadata)
    if kind not in VERB_OF or not all(isinstance(text, str) for text in texts):
        raise ValueError("no advertisement")
    if (
        type(name_bytes) is not bytes
        or len(name_bytes) != NAME_BYTES
        or type(endpoint) is not bytes
        or len(endpoint) != 16
    ):
        raise ValueError("no name")
    if not all(type(time_ns) is int and 0 <= time_ns < 1 << 63 for time_ns in (since_ns, expires_ns)):
        raise ValueError("no time")
    if not name.startswith("/") or len(name) > NAME_CHARACTERS or max(map(len, (type_, encoding))) > NAME_CHARACTERS:
        raise ValueError("no name")
    if max(map(len, metadata)) > OVERLAY_METADATA_CHARACTERS:
        raise ValueError("no metadata")
    profile = None if qos is None else _qos(*qos)
    return Advertisement(
        kind, name_bytes, endpoint, gateway, name, type_, profile, encoding, Metadata(*metadata), since_ns, expires_ns
    )


def _qos(
    reliability: str, durability: str, history: str, depth: int, deadline_s: float | None, lifespan_s: float | None
) -> QoS:
    """Build a profile after checking its values."""
    found = {"reliability": reliability, "durability": durability, "history": history, "depth": depth}
    times = {key: value for key, value in (("deadline", deadline_s), ("lifespan", lifespan_s)) if value is not None}
    return QoS.parse({**found, **times})


def _digest(gateway: bytes, body: bytes) -> bytes:
    return hashlib.sha256(_TAG + gateway + body).digest()
