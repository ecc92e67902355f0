"""Certificates, what stands in them, revocation lists and bundles."""

from __future__ import annotations

import datetime
import json
from typing import Final

from cryptography import x509
from cryptography.hazmat.primitives.serialization import Encoding

from fuzz.target import Target
from fuzz.targets.fleet import FLEET, MEMBER
from fuzz.targets.nested import NESTED_JSON
from ropeway.errors import IdentityError, SealError
from ropeway.networks.overlay.crypto.certificate import DENIED, RIGHTS, Certificate
from ropeway.networks.overlay.crypto.identity import Identity
from ropeway.networks.overlay.crypto.trust import Trust
from ropeway.networks.overlay.rights import EVERYTHING, Rights

__all__ = ["TARGETS"]

_NOW: Final = datetime.datetime(2026, 1, 1, tzinfo=datetime.timezone.utc)


def _certificate(data: bytes) -> None:
    Certificate(data)
    Trust(FLEET.ca).check(data)


def _rights(data: bytes) -> None:
    """The extension of a certificate that was issued rightly."""
    builder = x509.CertificateBuilder(FLEET.ca.subject, FLEET.ca.subject, MEMBER.certificate.x509.public_key(), 5)
    builder = builder.not_valid_before(_NOW).not_valid_after(_NOW + datetime.timedelta(1))
    builder = builder.add_extension(x509.UnrecognizedExtension(RIGHTS, data), critical=False)
    made = Certificate(builder.sign(MEMBER.key, None).public_bytes(Encoding.DER))
    made.rights.may("publish", "/a/_action/feedback")


def _revocation(data: bytes) -> None:
    """A list as it comes, and one that was signed rightly with any names."""
    trust = Trust(FLEET.ca)
    if data[:1] != b"\xff":
        trust.update(data)
        return
    builder = x509.CertificateRevocationListBuilder(FLEET.ca.subject, _NOW, _NOW + datetime.timedelta(1))
    builder = builder.add_extension(x509.CRLNumber(5), critical=False)
    builder = builder.add_extension(x509.UnrecognizedExtension(DENIED, data[1:]), critical=False)
    trust.update(builder.sign(FLEET._key, None).public_bytes(Encoding.DER))


def _bundle(data: bytes) -> None:
    Identity.parse(data.decode(errors="replace"), "a bundle")


TARGETS: Final = {
    "certificates": Target(_certificate, (SealError,), lambda: [MEMBER.certificate.der]),
    "rights": Target(
        _rights,
        (SealError,),
        lambda: [EVERYTHING.to_json(), Rights(("/a",)).to_json(), *NESTED_JSON],
        (b"null", b"[]", b'"publish"', b"\\ud800"),
    ),
    "revocations": Target(
        _revocation,
        (SealError,),
        lambda: [
            FLEET.crl.public_bytes(Encoding.DER),
            b'\xff["a"]',
            b"\xff[]",
            *(b"\xff" + value for value in NESTED_JSON),
        ],
        (b"null", b"\xff"),
    ),
    "bundles": Target(
        _bundle,
        (IdentityError,),
        lambda: [MEMBER.to_text().encode(), json.dumps({"ropeway": 1, "name": "a"}).encode(), *NESTED_JSON],
        (b"null", b"[]", b'"ropeway"', b'"key"', b'"routers"'),
        longest_bytes=8192,
    ),
}
