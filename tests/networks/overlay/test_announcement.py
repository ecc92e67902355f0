"""Notes between members."""

from __future__ import annotations

import cbor2
import pytest
from cryptography.exceptions import InvalidSignature
from cryptography.hazmat.primitives.asymmetric.ed25519 import Ed25519PrivateKey
from hypothesis import given, settings
from hypothesis import strategies as st

from ropeway.errors import SealError
from ropeway.networks.overlay.announcement import NoteKey
from ropeway.networks.overlay.refusal import Refusal

KEY = Ed25519PrivateKey.generate()
NOTES = NoteKey(bytes(32))
GATEWAY = bytes(range(16))
SHAPE = {"v": int}


class Owner:
    """A certificate that knows one key."""

    def __init__(self, key: Ed25519PrivateKey = KEY) -> None:
        self.key = key.public_key()

    def verify_signature(self, message: bytes, signature: bytes) -> bool:
        try:
            self.key.verify(signature, message)
        except InvalidSignature:
            return False
        return True


def sealed(body: object = None, kind: str = "delta") -> bytes:
    return NOTES.seal(GATEWAY, kind, {"v": 7} if body is None else body, KEY.sign)


def reason(raw: bytes, kind: str = "delta", gateway: bytes = GATEWAY, owner: Owner | None = None) -> Refusal:
    with pytest.raises(SealError) as caught:
        NOTES.open(raw, gateway, kind, SHAPE, lambda _: owner or Owner())
    assert isinstance(caught.value.reason, Refusal)
    return caught.value.reason


def test_round_trip() -> None:
    """A member reads what another tells, and nobody reads it without the fleet's secret."""
    raw = sealed({"v": 7, "text": "/camera"})
    assert NOTES.open(raw, GATEWAY, "delta", SHAPE, lambda _: Owner()) == {"v": 7, "text": "/camera"}
    assert b"camera" not in raw
    with pytest.raises(SealError):
        NoteKey(b"x" * 32).open(raw, GATEWAY, "delta", SHAPE, lambda _: Owner())


def test_refusals() -> None:
    """A note of another gateway, another kind, another sender, altered or cut is refused with its reason."""
    assert reason(sealed(), gateway=bytes(16)) is Refusal.BAD_TAG
    assert reason(sealed(), kind="hello") is Refusal.BAD_TAG
    assert reason(sealed(), owner=Owner(Ed25519PrivateKey.generate())) is Refusal.BAD_SIGNATURE
    assert reason(sealed()[:20]) is Refusal.TRUNCATED
    assert reason(sealed()[:-1]) is Refusal.BAD_TAG
    assert reason(sealed([1])) is Refusal.MALFORMED
    assert reason(sealed({"v": True})) is Refusal.MALFORMED
    assert reason(sealed({"w": 1})) is Refusal.MALFORMED


def test_member_cannot_sign_for_another() -> None:
    """A member, who has the fleet's secret, cannot tell a note in another's name."""
    forged = NOTES.seal(GATEWAY, "delta", {"v": 8}, Ed25519PrivateKey.generate().sign)
    assert reason(forged) is Refusal.BAD_SIGNATURE


@settings(max_examples=300)
@given(st.binary(max_size=200))
def test_random_bytes(raw: bytes) -> None:
    """Bytes that nobody sealed are refused."""
    assert reason(raw) in (Refusal.TRUNCATED, Refusal.BAD_TAG)


@given(st.binary(max_size=60))
def test_random_content(text: bytes) -> None:
    """What a member sealed but did not sign as a note is refused."""
    cipher = NOTES._cipher
    about = b"ropeway note 1\0\x10" + GATEWAY + b"\x05delta"
    for plain in (text, cbor2.dumps(text), cbor2.dumps((text, text)), cbor2.dumps((cbor2.dumps({"v": 1}), text))):
        raw = bytes(12) + cipher.encrypt(bytes(12), plain, about)
        assert reason(raw) in (Refusal.MALFORMED, Refusal.BAD_SIGNATURE)
