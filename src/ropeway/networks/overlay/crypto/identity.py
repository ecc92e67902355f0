"""Defines our identity in the overlay: one file, a bundle, with everything that a member or a router needs."""

from __future__ import annotations

import base64
import json
import os
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

from cryptography import x509
from cryptography.hazmat.primitives.asymmetric.ed25519 import Ed25519PrivateKey
from cryptography.hazmat.primitives.asymmetric.rsa import RSAPrivateKey
from cryptography.hazmat.primitives.serialization import (
    Encoding,
    NoEncryption,
    PrivateFormat,
    PublicFormat,
    load_pem_private_key,
)

from ropeway.errors import IdentityError
from ropeway.networks.overlay.crypto.certificate import Certificate, PrivateKey, common_name, sign
from ropeway.networks.overlay.crypto.material import check_private, read_material_text, read_secret, understood
from ropeway.types.untrusted import json_value

__all__ = ["Identity", "bundle_text", "private_pem", "public_bytes", "read_bundle", "write_private"]

_VERSION: Final = 1


def write_private(path: Path, text: str, *, replace: bool = False) -> None:
    """Write a file that only its owner may read. Raises ``IdentityError`` where it exists, or cannot be written."""
    target = path.with_name(f".{path.name}.{os.getpid()}") if replace else path
    try:
        with os.fdopen(os.open(target, os.O_WRONLY | os.O_CREAT | os.O_EXCL, 0o600), "w") as file:
            file.write(text)
            file.flush()
            os.fsync(file.fileno())
        if replace:
            target.replace(path)
    except FileExistsError:
        raise IdentityError(str(path), "it exists already and is never overwritten; name another file") from None
    except OSError as error:
        raise IdentityError(str(path), f"it cannot be written: {error.strerror}") from error


@dataclass(frozen=True)
class Identity:
    """A member (or router) of a fleet, with its private key.

    ``name_secret`` makes global names; routers have none. ``routers`` are Zenoh endpoints, ``crl`` the revocation list
    (DER) that was in force when the bundle was made, maybe empty.
    """

    certificate: Certificate
    key: PrivateKey
    ca: x509.Certificate
    name_secret: bytes | None
    routers: tuple[str, ...] = ()
    crl: bytes = b""

    @property
    def name(self) -> str:
        """The name in the certificate."""
        return self.certificate.name

    @property
    def fleet(self) -> str:
        """The name of the fleet."""
        return common_name(self.ca.subject)

    def sign(self, message: bytes) -> bytes:
        """Sign a message."""
        return sign(self.key, message)

    def tls(self) -> dict[str, Any]:
        """Return what Zenoh needs for mutual TLS, as options of ``transport/link/tls``."""
        certificate, key = self.certificate.pem, private_pem(self.key)
        ca = self.ca.public_bytes(Encoding.PEM).decode()
        coded = {"root_ca_certificate": ca}
        for side in ("listen", "connect"):
            coded |= {f"{side}_certificate": certificate, f"{side}_private_key": key}
        return {f"{name}_base64": base64.b64encode(text.encode()).decode() for name, text in coded.items()}

    # ── files ──────────────────────────────────────────────────────────────────────────────────────────────────

    @classmethod
    def load(cls, path: str | Path) -> Identity:
        """Read a bundle that nobody else can read. Raises ``IdentityError`` that says what to do."""
        path = Path(path)
        if not path.exists():
            raise IdentityError(str(path), "there is no such bundle; make one with: ropeway keys issue NAME")
        found = cls.parse(read_material_text(path), str(path))
        check_private(path)
        return found

    @classmethod
    def parse(cls, text: str, source: str) -> Identity:
        """Read the text of a bundle."""
        found = read_bundle(text, source)
        if "key" not in found:
            raise IdentityError(source, "it has no private key yet; put it together with: ropeway keys join")
        with understood(source, "it is damaged", "; have a new one issued"):
            ca = x509.load_pem_x509_certificate(found["ca"].encode())
            certificate = Certificate(_der(found["certificate"]))
            key = load_pem_private_key(found["key"].encode(), None)
            secret = read_secret(found["name_secret"]) if found.get("name_secret") else None
            crl = x509.load_pem_x509_crl(found["crl"].encode()).public_bytes(Encoding.DER) if found.get("crl") else b""
            routers = tuple(map(str, found.get("routers", ())))
        if not isinstance(key, (Ed25519PrivateKey, RSAPrivateKey)):
            raise IdentityError(source, "its key is neither Ed25519 nor RSA; have a new one issued")
        if public_bytes(key) != certificate.x509.public_key().public_bytes(
            Encoding.DER, PublicFormat.SubjectPublicKeyInfo
        ):
            raise IdentityError(source, "its key and its certificate do not go together; have a new one issued")
        return cls(certificate, key, ca, secret, routers, crl)

    def to_text(self) -> str:
        """Return the text of the bundle."""
        return bundle_text(
            self.certificate, self.ca, self.name_secret, self.routers, self.crl, key=self.key, fleet=self.fleet
        )


def bundle_text(
    certificate: Certificate,
    ca: x509.Certificate,
    name_secret: bytes | None,
    routers: tuple[str, ...],
    crl: bytes,
    *,
    key: PrivateKey | None,
    fleet: str,
) -> str:
    """Return the text of a bundle; without ``key``, one for a machine that keeps its own."""
    found: dict[str, Any] = {
        "ropeway": _VERSION,
        "fleet": fleet,
        "name": certificate.name,
        "role": certificate.role,
        "certificate": certificate.pem,
        "ca": ca.public_bytes(Encoding.PEM).decode(),
        "routers": list(routers),
    }
    if key is not None:
        found["key"] = private_pem(key)
    if name_secret is not None:
        found["name_secret"] = name_secret.hex()
    if crl:
        found["crl"] = x509.load_der_x509_crl(crl).public_bytes(Encoding.PEM).decode()
    return json.dumps(found, indent=1) + "\n"


def read_bundle(text: str, source: str) -> Mapping[str, Any]:
    """Read the fields of a bundle. Raises ``IdentityError`` for anything else."""
    try:
        found = json_value(text)
    except ValueError:
        found = None
    if not isinstance(found, dict) or "ropeway" not in found:
        raise IdentityError(source, "it is not a bundle; ropeway keys issue NAME writes one")
    if found["ropeway"] != _VERSION:
        raise IdentityError(source, f"it is a bundle of version {found['ropeway']}, which needs a newer ropeway")
    return found


def public_bytes(key: PrivateKey) -> bytes:
    """Return the public half of a key."""
    return key.public_key().public_bytes(Encoding.DER, PublicFormat.SubjectPublicKeyInfo)


def _der(pem: str) -> bytes:
    return x509.load_pem_x509_certificate(pem.encode()).public_bytes(Encoding.DER)


def private_pem(key: PrivateKey) -> str:
    """Return a private key as text."""
    return key.private_bytes(Encoding.PEM, PrivateFormat.PKCS8, NoEncryption()).decode()
