"""Decides which certificates to trust: those of the fleet's authority, in their time, for their purpose, not
revoked.
"""

from __future__ import annotations

import datetime
import threading
from typing import Final

from cryptography import x509
from cryptography.exceptions import InvalidSignature, UnsupportedAlgorithm
from cryptography.hazmat.primitives.serialization import Encoding
from cryptography.x509.oid import ExtensionOID

from ropeway.errors import SealError
from ropeway.limits import OVERLAY_CRL_BYTES
from ropeway.networks.overlay.crypto.certificate import DENIED, Certificate
from ropeway.networks.overlay.refusal import Refusal
from ropeway.types.untrusted import json_value

__all__ = ["Trust"]

_CACHED: Final = 8192


def _now() -> datetime.datetime:
    return datetime.datetime.now(datetime.timezone.utc)


class Trust:
    """The authority ``ca`` of a fleet, and its newest revocation list. Safe to use from several threads.

    ``denied`` are the names that have no certificate any more.
    """

    def __init__(self, ca: x509.Certificate, crl: bytes = b"") -> None:
        self._ca = ca
        self._known: dict[bytes, Certificate] = {}
        self._lock = threading.Lock()
        self._revoked: frozenset[int] = frozenset()
        self.denied: frozenset[str] = frozenset()
        self.crl = b""
        self.crl_number = 0
        if crl:
            self.update(crl)

    def check(self, der: bytes, *, now: datetime.datetime | None = None, role: str = "member") -> Certificate:
        """Return the certificate in ``der``, if it can be trusted now.

        Raises ``SealError``: MALFORMED, UNKNOWN_CA, WRONG_PURPOSE, NOT_YET_VALID, EXPIRED or REVOKED.
        """
        certificate = self._known.get(der)
        if certificate is None:
            certificate = Certificate(der)
            if der[-len(certificate.x509.signature) - 1] != 0:  # unused bits of the signature, which nobody signs
                raise SealError(Refusal.MALFORMED, certificate.name)
            try:
                certificate.x509.verify_directly_issued_by(self._ca)
            except (ValueError, TypeError, InvalidSignature, UnsupportedAlgorithm) as error:
                raise SealError(Refusal.UNKNOWN_CA, certificate.name) from error
            with self._lock:
                if len(self._known) >= _CACHED:
                    self._known.clear()
                self._known[der] = certificate
        if certificate.role != role:
            raise SealError(Refusal.WRONG_PURPOSE, certificate.name)
        now = now or _now()
        if now < certificate.not_before:
            raise SealError(Refusal.NOT_YET_VALID, certificate.name)
        if now > certificate.not_after:
            raise SealError(Refusal.EXPIRED, certificate.name)
        if certificate.serial in self._revoked:
            raise SealError(Refusal.REVOKED, certificate.name)
        return certificate

    @property
    def revokes(self) -> bool:
        """Return whether anybody was ever revoked."""
        return bool(self._revoked)

    def revoked(self, serial: int) -> bool:
        """Return whether the certificate with this serial number was revoked."""
        return serial in self._revoked

    def update(self, crl: bytes) -> bool:
        """Take a revocation list (DER or PEM); false if it is not newer than the one in force.

        Raises ``SealError``: MALFORMED, or UNKNOWN_CA for a list that the authority did not sign.
        """
        if len(crl) > OVERLAY_CRL_BYTES:
            raise SealError(Refusal.TOO_BIG, "a revocation list")
        try:
            pem = crl.startswith(b"-----")
            found = x509.load_pem_x509_crl(crl) if pem else x509.load_der_x509_crl(crl)
            if not found.is_signature_valid(self._ca.public_key()):  # type: ignore[arg-type]
                raise SealError(Refusal.UNKNOWN_CA, "a revocation list")
            number = found.extensions.get_extension_for_oid(ExtensionOID.CRL_NUMBER).value
            denied = _denied(found)
        except SealError:
            raise
        except Exception as error:  # of a library that reads what others wrote, which raises many kinds
            raise SealError(Refusal.MALFORMED, "a revocation list") from error
        assert isinstance(number, x509.CRLNumber)
        with self._lock:
            if number.crl_number <= self.crl_number:
                return False
            self._revoked = frozenset(entry.serial_number for entry in found)
            self.denied = denied
            self.crl, self.crl_number = found.public_bytes(Encoding.DER), number.crl_number
        return True


def _denied(crl: x509.CertificateRevocationList) -> frozenset[str]:
    try:
        found = crl.extensions.get_extension_for_oid(DENIED).value
    except x509.ExtensionNotFound:
        return frozenset()
    assert isinstance(found, x509.UnrecognizedExtension)
    return frozenset(map(str, json_value(found.value)))
