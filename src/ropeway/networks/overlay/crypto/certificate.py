"""Certificates of a fleet: X.509, with what the owner is and may do in extensions of our own."""

from __future__ import annotations

import datetime
from typing import Final

from cryptography import x509
from cryptography.exceptions import InvalidSignature
from cryptography.hazmat.primitives import hashes
from cryptography.hazmat.primitives.asymmetric import padding
from cryptography.hazmat.primitives.asymmetric.ed25519 import Ed25519PrivateKey, Ed25519PublicKey
from cryptography.hazmat.primitives.asymmetric.rsa import RSAPrivateKey, RSAPublicKey
from cryptography.hazmat.primitives.serialization import Encoding
from cryptography.x509.oid import ExtendedKeyUsageOID, NameOID

from ropeway.errors import SealError
from ropeway.networks.overlay.refusal import Refusal
from ropeway.networks.overlay.rights import Rights

__all__ = [
    "DENIED",
    "MEMBER",
    "RIGHTS",
    "ROUTER",
    "Certificate",
    "PrivateKey",
    "common_name",
    "sign",
    "verify",
]

_ARC: Final = "2.25.114302843702948562374012342190733265517"  # made of a random UUID, as X.667 allows to anybody
RIGHTS: Final = x509.ObjectIdentifier(f"{_ARC}.1")
"""The extension with the rights of a member, as JSON."""

DENIED: Final = x509.ObjectIdentifier(f"{_ARC}.4")
"""The extension of a revocation list with the names that have no certificate any more, as JSON: routers go by names."""

MEMBER: Final = x509.ObjectIdentifier(f"{_ARC}.2")
ROUTER: Final = x509.ObjectIdentifier(f"{_ARC}.3")
"""Extended key usages: what a certificate was issued for."""

_PSS: Final = padding.PSS(padding.MGF1(hashes.SHA256()), 32)

PrivateKey = Ed25519PrivateKey | RSAPrivateKey


def sign(key: PrivateKey, message: bytes) -> bytes:
    """Sign ``message`` with Ed25519, or RSASSA-PSS with SHA-256 (FogROS2-SGC thesis, 3.3)."""
    if isinstance(key, Ed25519PrivateKey):
        return key.sign(message)
    return key.sign(message, _PSS, hashes.SHA256())


def verify(key: Ed25519PublicKey | RSAPublicKey, message: bytes, signature: bytes) -> bool:
    """Return whether the owner of ``key`` signed ``message``."""
    try:
        if isinstance(key, Ed25519PublicKey):
            key.verify(signature, message)
        else:
            key.verify(signature, message, _PSS, hashes.SHA256())
    except InvalidSignature:
        return False
    return True


def common_name(name: x509.Name) -> str:
    """Return the common name, ``""`` if there is none."""
    found = name.get_attributes_for_oid(NameOID.COMMON_NAME)
    return str(found[0].value) if found else ""


class Certificate:
    """A parsed certificate. Raises ``SealError`` for bytes that are none, or have a key of another kind.

    Whether it is to be believed is for ``ropeway.networks.overlay.crypto.trust.Trust`` to say.
    """

    __slots__ = (
        "_key",
        "der",
        "fingerprint",
        "name",
        "not_after",
        "not_before",
        "purposes",
        "rights",
        "serial",
        "x509",
    )

    def __init__(self, der: bytes) -> None:
        try:
            self.x509 = x509.load_der_x509_certificate(der)
            key = self.x509.public_key()
            self.purposes, self.rights = _purposes(self.x509), _rights(self.x509)
            self.name = common_name(self.x509.subject)
        except Exception as error:  # of a library that reads what others wrote, which raises many kinds
            raise SealError(Refusal.MALFORMED, "a certificate") from error
        if not isinstance(key, (Ed25519PublicKey, RSAPublicKey)):
            raise SealError(Refusal.WRONG_PURPOSE, f"{self.name}: its key is neither Ed25519 nor RSA")
        self._key = key
        self.der = der
        self.fingerprint = self.x509.fingerprint(hashes.SHA256())
        self.serial = self.x509.serial_number
        self.not_before, self.not_after = self.x509.not_valid_before_utc, self.x509.not_valid_after_utc

    @property
    def pem(self) -> str:
        """The certificate as text."""
        return self.x509.public_bytes(Encoding.PEM).decode()

    @property
    def role(self) -> str:
        """``member``, ``router``, or ``""``."""
        if MEMBER in self.purposes:
            return "member"
        return "router" if ROUTER in self.purposes else ""

    def valid(self, now: datetime.datetime) -> bool:
        """Return whether ``now`` is within its period of validity."""
        return self.not_before <= now <= self.not_after

    def verify_signature(self, message: bytes, signature: bytes) -> bool:
        """Return whether the owner signed ``message``."""
        return verify(self._key, message, signature)


def _purposes(certificate: x509.Certificate) -> frozenset[x509.ObjectIdentifier]:
    try:
        usage = certificate.extensions.get_extension_for_class(x509.ExtendedKeyUsage)
    except x509.ExtensionNotFound:
        return frozenset()
    return frozenset(usage.value) - {ExtendedKeyUsageOID.SERVER_AUTH, ExtendedKeyUsageOID.CLIENT_AUTH}


def _rights(certificate: x509.Certificate) -> Rights:
    try:
        found = certificate.extensions.get_extension_for_oid(RIGHTS).value
    except x509.ExtensionNotFound:
        return Rights()
    assert isinstance(found, x509.UnrecognizedExtension)
    return Rights.from_json(found.value)
