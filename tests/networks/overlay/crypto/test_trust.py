"""Which certificates are believed."""

from __future__ import annotations

import datetime
import random

import pytest
from cryptography import x509
from cryptography.hazmat.primitives.serialization import Encoding
from cryptography.x509.oid import ExtendedKeyUsageOID, NameOID

from ropeway.errors import SealError
from ropeway.networks.overlay.crypto.trust import Trust
from ropeway.networks.overlay.fleet import Fleet, new_key
from ropeway.networks.overlay.refusal import Refusal
from tests.networks.overlay.fleet import fleet, member


def refused(trust: Trust, der: bytes, **options: object) -> Refusal:
    with pytest.raises(SealError) as caught:
        trust.check(der, **options)  # type: ignore[arg-type]
    assert isinstance(caught.value.reason, Refusal)
    return caught.value.reason


def test_of_the_fleet() -> None:
    """A member's certificate is believed, with its name and rights; one of another fleet is not."""
    robot = member("robot")
    found = Trust(robot.ca).check(robot.certificate.der)
    assert found.name == robot.name
    assert found.role == "member"
    stranger = fleet("another").issue("robot")
    assert refused(Trust(robot.ca), stranger.certificate.der) is Refusal.UNKNOWN_CA


def test_time() -> None:
    """A certificate is believed within its time only, also when it was believed before."""
    robot = member("robot", days=1)
    trust = Trust(robot.ca)
    trust.check(robot.certificate.der)
    later = robot.certificate.not_after + datetime.timedelta(seconds=1)
    earlier = robot.certificate.not_before - datetime.timedelta(seconds=1)
    assert refused(trust, robot.certificate.der, now=later) is Refusal.EXPIRED
    assert refused(trust, robot.certificate.der, now=earlier) is Refusal.NOT_YET_VALID


def test_purpose() -> None:
    """What the authority signed for something else is of no use: a router's, a web server's, its own."""
    made = fleet()
    trust = Trust(made.ca)
    router = made.issue(f"router{random.random()}".replace("0.", "-"), role="router")
    assert refused(trust, router.certificate.der) is Refusal.WRONG_PURPOSE
    assert trust.check(router.certificate.der, role="router").role == "router"
    assert refused(trust, member().certificate.der, role="router") is Refusal.WRONG_PURPOSE
    assert refused(trust, _web_server(made)) is Refusal.WRONG_PURPOSE
    assert refused(trust, made.ca.public_bytes(Encoding.DER)) is Refusal.WRONG_PURPOSE


def _web_server(made: Fleet) -> bytes:
    now = datetime.datetime.now(datetime.timezone.utc)
    name = x509.Name([x509.NameAttribute(NameOID.COMMON_NAME, "www")])
    built = (
        x509.CertificateBuilder()
        .subject_name(name)
        .issuer_name(made.ca.subject)
        .public_key(new_key("ed25519").public_key())
        .serial_number(1)
        .not_valid_before(now)
        .not_valid_after(now + datetime.timedelta(days=1))
        .add_extension(x509.ExtendedKeyUsage([ExtendedKeyUsageOID.SERVER_AUTH]), critical=False)
    )
    return built.sign(made._key, None).public_bytes(Encoding.DER)


def test_revocation() -> None:
    """A revocation list of the authority is in force at once, and only a newer one replaces it."""
    made = fleet("revoking")
    one, two = made.issue("one"), made.issue("two")
    trust = Trust(made.ca, made.crl_der())
    old = made.crl_der()
    trust.check(one.certificate.der)
    made.revoke("one")
    assert trust.update(made.crl_der())
    assert refused(trust, one.certificate.der) is Refusal.REVOKED
    assert trust.revoked(one.certificate.serial)
    assert trust.denied == {"one"}
    trust.check(two.certificate.der)
    assert not trust.update(old)
    assert not trust.update(made.crl_der())
    assert refused(trust, one.certificate.der) is Refusal.REVOKED
    again = made.issue("one")
    assert trust.update(made.crl.public_bytes(Encoding.PEM))
    assert trust.denied == frozenset()
    trust.check(again.certificate.der)
    assert refused(trust, one.certificate.der) is Refusal.REVOKED


def test_lists_of_others() -> None:
    """A revocation list that the authority did not sign is refused and changes nothing."""
    made, other = fleet("lists"), fleet("other-lists")
    trust = Trust(made.ca)
    robot = made.issue("robot")
    for crl in (other.crl_der(), made.crl_der()[:-1] + bytes([made.crl_der()[-1] ^ 1]), b"", b"x" * 50):
        with pytest.raises(SealError):
            trust.update(crl)
    assert trust.crl_number == 0
    trust.check(robot.certificate.der)


@pytest.mark.filterwarnings("ignore:Parsed a serial number")
def test_random_bytes() -> None:
    """Whatever comes as a certificate is refused with a reason."""
    robot = member("robot")
    trust, rng = Trust(robot.ca), random.Random(4)
    for _ in range(3000):
        raw = bytearray(robot.certificate.der)
        for _ in range(rng.randrange(1, 5)):
            raw[rng.randrange(len(raw))] ^= 1 << rng.randrange(8)
        if rng.random() < 0.2:
            del raw[rng.randrange(len(raw)) :]
        if raw != robot.certificate.der:  # two flips of one bit
            refused(trust, bytes(raw))
