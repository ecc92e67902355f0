"""What members and routers of the overlay send, with seals and signatures put right so that the inside is reached."""

from __future__ import annotations

import os
import struct
from typing import Final

import cbor2

from fuzz.target import Target
from fuzz.targets.fleet import FLEET, MEMBER
from fuzz.targets.nested import NESTED_CBOR
from ropeway.delivery.compression import filters
from ropeway.errors import SealError
from ropeway.networks.overlay import advert
from ropeway.networks.overlay import announcement as note
from ropeway.networks.overlay.crypto import channel
from ropeway.networks.overlay.crypto.seal import ContentKey, Grant, Opener, Sealer
from ropeway.networks.overlay.crypto.trust import Trust
from ropeway.networks.overlay.names import Metadata, global_name
from ropeway.networks.overlay.packet_item import RAW, ZSTD, PacketItem, pack, read_item

__all__ = ["TARGETS"]

_GATEWAY: Final = bytes(range(16))
_NAME: Final = bytes(range(32))
_ADVERT_KEY: Final = advert.advert_key(FLEET.name_secret)
_TRUST: Final = Trust(FLEET.ca)
_SHAPE: Final = {"name": str, "at": int, "certificate": bytes}


def _advert(data: bytes) -> None:
    """A body that its owner signed, or (after a mark) whatever is where body and signature should be."""
    signed = data[1:]
    if data[:1] != b"\xff":
        signed = cbor2.dumps((data, MEMBER.sign(advert._digest(_GATEWAY, data))))
    nonce = bytes(12)
    raw = nonce + _ADVERT_KEY.encrypt(nonce, signed, advert._TAG + _GATEWAY)
    advert.read_advert(raw, _GATEWAY, MEMBER.certificate, _ADVERT_KEY, FLEET.name_secret, now_ns=0)


def _adverts() -> list[bytes]:
    type, metadata = "std_msgs/msg/String", ["", "", "", "x"][: len(Metadata.__dataclass_fields__)]
    about = Metadata(*metadata)
    name = global_name(FLEET.name_secret, "topic", "/a", type, about)
    qos = ["reliable", "volatile", "keep_last", 5, None, 1.5]
    fields = ["publisher", name, bytes(16), "/a", type, qos, "auto", metadata, 1, 2]
    return [
        cbor2.dumps(fields),
        cbor2.dumps([*fields[:5], None, *fields[6:]]),
        b"\xff" + cbor2.dumps([b"x", bytes(64)]),
        *NESTED_CBOR,
    ]


def _note(data: bytes) -> None:
    """A text that its owner signed, or (after a mark) whatever is where text and signature should be."""
    key, about = note.NoteKey(FLEET.name_secret), note._about(_GATEWAY, "heartbeat")
    signed = data[1:]
    if data[:1] != b"\xff":
        signed = cbor2.dumps((data, MEMBER.sign(note.hashlib.sha256(about + data).digest())))
    nonce = bytes(12)
    raw = nonce + key._cipher.encrypt(nonce, signed, about)
    found = key.open(raw, _GATEWAY, "heartbeat", _SHAPE, lambda body: MEMBER.certificate)
    assert all(type(found[key]) is kind for key, kind in _SHAPE.items())


def _seal(data: bytes) -> None:
    """A packet as it comes."""
    opener = Opener(_NAME, _GATEWAY, lambda message, signature: True, secret=bytes(32), unsigned=True)
    opener.add(Grant(ContentKey(1, bytes(32)), ContentKey(2, bytes(32)), 0))
    opener.open(data)


def _seals() -> list[bytes]:
    sealers = [Sealer(_NAME, _GATEWAY, sign) for sign in (None, MEMBER.sign, None)]
    sealers[2]._use(ContentKey(1, bytes(32)), ContentKey(2, bytes(32)))
    sealers[2].prove_to([b"1" * 32, bytes(32)])
    return [sealer.seal([[b"x"]]) for sealer in sealers]


def _sealed(data: bytes) -> None:
    """What stands inside a packet that was sealed rightly: messages behind their lengths, and how many there are."""
    sealer = Sealer(_NAME, _GATEWAY, None)
    opener = Opener(_NAME, _GATEWAY, lambda message, signature: True, unsigned=True)
    opener.add(sealer.grant())
    for raw in opener.open(sealer.seal([[item] for item in data.split(b"item")])).items:
        read_item(raw)


def _items() -> list[bytes]:
    item = PacketItem(1, 2, 3, _GATEWAY, 0, RAW, b"\0\1\0\0payload")
    image = struct.pack("<BBBxIIII", 3, 4, 2, 0, 0, 1600, 400)
    bodies = (filters.encode(bytes(2000), ""), filters.encode(b"x", ""), image)
    return [pack(item), b"item".join(pack(item._replace(encoding=ZSTD, payload=body)) for body in bodies)]


def _greeting(data: bytes) -> None:
    """A greeting that its sender signed, and one that is not."""
    if data[:1] == b"\xff":
        channel.respond(MEMBER, _GATEWAY, data[1:], _TRUST)
        return
    hello = cbor2.dumps((data, MEMBER.sign(channel._hash(channel._HELLO_TAG, _GATEWAY, data))))
    reply, _ = channel.respond(MEMBER, _GATEWAY, hello, _TRUST)
    channel.Initiator(MEMBER, _GATEWAY).finish(reply, _TRUST)


def _greetings() -> list[bytes]:
    hello = channel.Initiator(MEMBER, _GATEWAY).hello
    return [cbor2.loads(hello)[0], b"\xff" + hello, *NESTED_CBOR]


TARGETS: Final = {
    "adverts": Target(_advert, (SealError,), _adverts, (b"\xf6", b"\xfb", b"\xc2", b"\xd8\x1c", b"\x80", b"\xa0")),
    "notes": Target(
        _note,
        (SealError,),
        lambda: [cbor2.dumps({"name": "a", "at": 1, "certificate": b"x"}), b"\xff\x82\x41x\x41x", *NESTED_CBOR],
    ),
    "seals": Target(_seal, (SealError,), _seals),
    "sealed-items": Target(_sealed, (SealError,), _items, (b"item",)),
    "grants": Target(
        Grant.from_cbor,
        (SealError,),
        lambda: [Grant(ContentKey(1, bytes(32)), ContentKey(2, os.urandom(32)), 7).to_cbor(), *NESTED_CBOR],
    ),
    "greetings": Target(_greeting, (SealError,), _greetings),
}
