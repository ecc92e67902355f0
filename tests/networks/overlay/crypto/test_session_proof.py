"""ropeway.networks.overlay.crypto.session_proof, alone and in sealed packets."""

from __future__ import annotations

import os
import struct

import pytest

from ropeway.errors import SealError
from ropeway.networks.overlay.crypto.seal import Grant, Opener, Sealer, check_signature, peek
from ropeway.networks.overlay.crypto.session_proof import PROOF_BYTES, SECRET_BYTES, SessionKey, prove
from ropeway.networks.overlay.refusal import Refusal
from tests.networks.overlay.fleet import member

NAME, PUBLISHER = bytes(range(32)), bytes(range(16))
OWNER = member("publisher")
MINE, THEIRS = os.urandom(SECRET_BYTES), os.urandom(SECRET_BYTES)
HEAD_BYTES = 20
FLAGS = 2  # where they stand in the head


def sealer(*secrets: bytes, name: bytes = NAME, publisher: bytes = PUBLISHER) -> Sealer:
    made = Sealer(name, publisher, OWNER.sign)
    made.prove_to(secrets)
    return made


def opener(grant: Grant, secret: bytes = MINE) -> Opener:
    made = Opener(NAME, PUBLISHER, OWNER.certificate.verify_signature, secret=secret)
    made.add(grant)
    return made


def reason(reader: Opener, packet: bytes) -> Refusal:
    with pytest.raises(SealError) as caught:
        reader.open(packet)
    assert isinstance(caught.value.reason, Refusal)
    return caught.value.reason


def same_keys(source: Sealer, *secrets: bytes) -> Sealer:
    """Return a sealer of a reader, which has the content keys, and so many secrets of sessions."""
    forger = sealer(*secrets)
    grant = source.grant()
    forger._use(grant.current, grant.next)
    forger.counter = grant.counter
    return forger


@pytest.mark.parametrize("size", [0, 5, 1000, 305_000])
def test_each_reader_finds_its_proof(size: int) -> None:
    """A packet is proven to every reader that gave a secret, in as many bytes for each, and signed for nobody."""
    source = sealer(MINE, THEIRS)
    readers = [opener(source.grant()), opener(source.grant(), THEIRS)]
    payload = os.urandom(size)
    packet = source.seal([[payload], [b"another"]])
    head = peek(packet)
    assert (head.session, head.signed, head.proof_bytes) == (True, False, 2 * PROOF_BYTES)
    assert [[bytes(item) for item in reader.open(packet).items] for reader in readers] == [[payload, b"another"]] * 2


def test_another_reader_cannot_forge() -> None:
    """A reader, which has the content key and a secret of its own, makes no packet that another one believes."""
    source = sealer(MINE, THEIRS)
    reader = opener(source.grant())
    forged = bytearray(same_keys(source, THEIRS, THEIRS).seal([[b"forged"]]))
    assert reason(reader, bytes(forged)) is Refusal.UNPROVEN
    ids = SessionKey(MINE, NAME + PUBLISHER, source.epoch).id  # seen in the packets of the publisher
    forged[-PROOF_BYTES : -PROOF_BYTES + len(ids)] = ids
    assert reason(reader, bytes(forged)) is Refusal.BAD_SIGNATURE
    assert reader.open(source.seal([[b"real"]])).items == [b"real"]


def test_proofs_of_another_packet() -> None:
    """Proofs go with one packet, one name and one publisher; moved to another they are refused."""
    source = sealer(MINE)
    reader = opener(source.grant())
    first, second = source.seal([[b"same"]]), source.seal([[b"same"]])
    moved = second[:-PROOF_BYTES] + first[-PROOF_BYTES:]
    assert reason(reader, moved) is Refusal.BAD_SIGNATURE
    grant = source.grant()
    for name, publisher in ((bytes(32), PUBLISHER), (NAME, bytes(16))):
        other = sealer(MINE, name=name, publisher=publisher)
        other._use(grant.current, grant.next)
        assert reason(reader, other.seal([[b"same"]])) is Refusal.UNPROVEN
    assert reader.open(second).items == [b"same"]


def test_altered_and_replayed() -> None:
    """Whatever bit of a packet is altered, it is refused; so is one that comes again, or is older than the grant."""
    source = sealer(MINE)
    early = source.seal([[b"early"]])
    reader = opener(source.grant())
    packet = source.seal([[b"data"]])
    for at in range(len(packet)):
        altered = bytearray(packet)
        altered[at] ^= 1
        with pytest.raises(SealError):
            reader.open(bytes(altered))
    assert reader.open(packet).items == [b"data"]
    assert reason(reader, packet) is Refusal.REPLAYED
    assert reason(reader, early) is Refusal.TOO_OLD


def test_no_way_down() -> None:
    """A signed packet cannot be made into one with proofs, nor one with proofs into one with neither."""
    source = sealer(MINE)
    reader = opener(source.grant())
    proven = bytearray(source.seal([[b"data"]]))
    for flags in (0, 1, 3, 4, 255):
        proven[FLAGS] = flags
        assert reason(reader, bytes(proven)) in (Refusal.BAD_SIGNATURE, Refusal.MALFORMED)
    source.prove_to(())
    signed = bytearray(source.seal([[b"data"]]))
    assert peek(bytes(signed)).signed
    signed[FLAGS] = 2
    assert reason(reader, bytes(signed)) is Refusal.MALFORMED  # 64 bytes are no row of proofs
    cut = signed[:-64] + bytes(PROOF_BYTES)
    struct.pack_into(">H", cut, HEAD_BYTES - 2, PROOF_BYTES)
    assert reason(reader, bytes(cut)) is Refusal.UNPROVEN


def test_a_reader_that_wants_signatures() -> None:
    """A reader that gave no secret believes no proofs, whoever made them, and opens what is signed."""
    source = sealer(MINE)
    reader = opener(source.grant(), b"")
    assert reason(reader, source.seal([[b"data"]])) is Refusal.BAD_SIGNATURE
    source.prove_to(())
    assert reader.open(source.seal([[b"data"]])).items == [b"data"]


def test_signed_is_believed_all_the_same() -> None:
    """A reader with a secret opens signed packets: the publisher signs as soon as somebody wants that."""
    source = sealer()
    reader = opener(source.grant())
    assert reader.open(source.seal([[b"data"]])).items == [b"data"]
    source.prove_to((MINE,))
    assert reader.open(source.seal([[b"more"]])).items == [b"more"]


def test_keys_are_replaced() -> None:
    """With each content key the keys of proofs are others, ids as well, so that routers cannot tell who stays."""
    source = sealer(MINE)
    reader = opener(source.grant())
    first = source.seal([[b"1"]])
    source.rotate()
    second = source.seal([[b"2"]])
    assert first[-PROOF_BYTES:-16] != second[-PROOF_BYTES:-16]
    assert [reader.open(packet).items for packet in (first, second)] == [[b"1"], [b"2"]]
    for _ in range(6):
        source.rotate()
        reader.add(source.grant())
        assert reader.open(source.seal([[b"n"]])).items == [b"n"]
    assert reader._sessions.keys() <= reader._keys.keys()


def test_auditors_are_told() -> None:
    """What was proven to readers alone is no evidence, and an auditor is told why."""
    with pytest.raises(SealError, match="to their readers alone"):
        check_signature(sealer(MINE).seal([[b"x"]]), NAME, PUBLISHER, OWNER.certificate.verify_signature)


def test_alone() -> None:
    """A key proves bytes under a nonce, and finds its proof among others; a part of a proof is none."""
    keys = [SessionKey(secret, NAME, 1) for secret in (MINE, THEIRS)]
    proofs = memoryview(b"".join(prove(keys, bytes(12), b"sealed")))
    for key in keys:
        tag = key.among(proofs)
        assert tag is not None
        assert key.holds(bytes(12), memoryview(b"sealed"), tag)
        assert not key.holds(bytes(12), memoryview(b"other"), tag)
        assert not key.holds(bytes(11) + b"1", memoryview(b"sealed"), tag)
    assert keys[0].among(proofs[PROOF_BYTES:]) is None
    assert keys[0].among(memoryview(b"")) is None
