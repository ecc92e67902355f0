"""A fleet: the authority that says who belongs to it. Its directory stays with whoever runs it, and never on a robot.

::

    FLEET/  ca.pem       the authority's certificate
            ca.key       its key (0600)
            name.secret  what global names are made under (0600); no signing key
            crl.pem      who was revoked
            fleet.json   what was issued
            lock         held by who changes it

Changes are made one at a time, by however many processes, and each is on the disk before anything of it is handed out:
a certificate that exists can be revoked.
"""

from __future__ import annotations

import contextlib
import datetime
import json
import secrets
import shutil
from collections.abc import Collection, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any, Final

from cryptography import x509
from cryptography.hazmat.primitives import hashes
from cryptography.hazmat.primitives.asymmetric.ed25519 import Ed25519PrivateKey, Ed25519PublicKey
from cryptography.hazmat.primitives.asymmetric.rsa import RSAPrivateKey, RSAPublicKey, generate_private_key
from cryptography.hazmat.primitives.serialization import Encoding, load_pem_private_key
from cryptography.x509.oid import ExtendedKeyUsageOID, NameOID

from ropeway.errors import IdentityError
from ropeway.networks.overlay.crypto.certificate import (
    DENIED,
    MEMBER,
    RIGHTS,
    ROUTER,
    Certificate,
    PrivateKey,
    common_name,
)
from ropeway.networks.overlay.crypto.identity import Identity, bundle_text, private_pem, write_private
from ropeway.networks.overlay.crypto.material import SECRET_BYTES, check_private, read_secret, understood
from ropeway.networks.overlay.durable import locked, write_durable
from ropeway.networks.overlay.rights import EVERYTHING, VERBS, Rights
from ropeway.types.untrusted import json_value

__all__ = ["ALGORITHMS", "Fleet", "make_request", "new_key", "valid_name"]

ALGORITHMS: Final = ("ed25519", "rsa")

_CA_DAYS: Final = 3650
_CRL_DAYS: Final = 3650  # a list is replaced by a newer one, not by time
_BACKDATED: Final = datetime.timedelta(minutes=5)  # clocks differ
_RSA_BITS: Final = 3072


def valid_name(name: str) -> str:
    """Check the name of a fleet or a member and return it. Raises ``IdentityError``."""
    good = name and len(name) <= 63 and all(c.isascii() and (c.isalnum() or c in "-_.") for c in name)
    if not good or name[0] in "-.":
        raise IdentityError(
            name, "a name has 1 to 63 letters, digits, '-', '_' and '.', and starts with one of the first"
        )
    return name


def new_key(algorithm: str) -> PrivateKey:
    """Make a private key of one of ``ALGORITHMS``. Raises ``IdentityError`` for another."""
    if algorithm not in ALGORITHMS:
        raise IdentityError(algorithm, f"expected one of {', '.join(ALGORITHMS)}")
    return Ed25519PrivateKey.generate() if algorithm == "ed25519" else generate_private_key(65537, _RSA_BITS)


class Fleet:
    """The directory of a fleet, opened. Raises ``IdentityError`` where it is none."""

    def __init__(self, directory: Path) -> None:
        self.directory = directory
        self._record: dict[str, Any]
        hint = "; make one with: ropeway keys init NAME"
        with understood(str(directory), "it is not the directory of a fleet", hint):
            self.ca = x509.load_pem_x509_certificate((directory / "ca.pem").read_bytes())
            key = load_pem_private_key((directory / "ca.key").read_bytes(), None)
            self.name_secret = read_secret((directory / "name.secret").read_text().strip())
            self.crl = x509.load_pem_x509_crl((directory / "crl.pem").read_bytes())
            self._record = _read_record(directory)
        for name in ("ca.key", "name.secret"):
            check_private(directory / name)
        if not isinstance(key, (Ed25519PrivateKey, RSAPrivateKey)):
            raise IdentityError(str(directory), "the authority's key is neither Ed25519 nor RSA")
        self._key: PrivateKey = key

    @classmethod
    def create(cls, name: str, directory: Path, *, algorithm: str = "ed25519", routers: Sequence[str] = ()) -> Fleet:
        """Make a fleet in a directory that does not exist yet."""
        valid_name(name)
        key = new_key(algorithm)
        directory = directory.absolute()
        if directory.exists():
            raise IdentityError(str(directory), "it exists already; a fleet is never made anew in place")
        made = directory.with_name(f".{directory.name}.{secrets.token_hex(4)}")  # all of it is there, or nothing
        try:
            made.mkdir(mode=0o700, parents=True)
            cls._fill(made, name, key, routers)
            made.rename(directory)
        except OSError as error:
            shutil.rmtree(made, ignore_errors=True)
            raise IdentityError(str(directory), f"it cannot be made: {error.strerror}") from error
        return cls(directory)

    @staticmethod
    def _fill(directory: Path, name: str, key: PrivateKey, routers: Sequence[str]) -> None:
        subject = x509.Name([x509.NameAttribute(NameOID.COMMON_NAME, name)])
        now = datetime.datetime.now(datetime.timezone.utc)
        ca = (
            x509.CertificateBuilder()
            .subject_name(subject)
            .issuer_name(subject)
            .public_key(key.public_key())
            .serial_number(x509.random_serial_number())
            .not_valid_before(now - _BACKDATED)
            .not_valid_after(now + datetime.timedelta(days=_CA_DAYS))
            .add_extension(x509.BasicConstraints(True, 0), critical=True)
            .add_extension(_usage(authority=True), critical=True)
            .add_extension(x509.SubjectKeyIdentifier.from_public_key(key.public_key()), critical=False)
            .sign(key, _hash(key))
        )
        write_durable(directory / "ca.pem", ca.public_bytes(Encoding.PEM))
        write_private(directory / "ca.key", private_pem(key))
        write_private(directory / "name.secret", secrets.token_hex(SECRET_BYTES) + "\n")
        write_durable(directory / "crl.pem", _crl(ca, key, 1, ()).public_bytes(Encoding.PEM))
        record = {"name": name, "created": now.isoformat(), "routers": list(routers), "issued": []}
        write_durable(directory / "fleet.json", _json(record))

    @contextlib.contextmanager
    def _changing(self) -> Iterator[None]:
        """Change the fleet as it is now, while nobody else does."""
        with locked(self.directory / "lock"):
            with understood(str(self.directory), "the fleet cannot be read any more"):
                self._record = _read_record(self.directory)
                raw = (self.directory / "crl.pem").read_bytes()
            with contextlib.suppress(IdentityError), understood(str(self.directory), "a damaged list"):
                self.crl = x509.load_pem_x509_crl(raw)  # if not, it is written again, as it was known here
            yield

    @property
    def name(self) -> str:
        """The name of the fleet."""
        return common_name(self.ca.subject)

    @property
    def routers(self) -> tuple[str, ...]:
        """The addresses of its routers."""
        return tuple(self._record["routers"])

    @property
    def algorithm(self) -> str:
        """The algorithm of its keys."""
        return "ed25519" if isinstance(self._key, Ed25519PrivateKey) else "rsa"

    def issued(self) -> list[dict[str, Any]]:
        """Return what was issued, oldest first."""
        return [dict(row) for row in self._record["issued"]]

    # ── issuing ────────────────────────────────────────────────────────────────────────────────────────────────

    def issue(
        self,
        name: str,
        *,
        role: str = "member",
        rights: Rights | None = None,
        days: float = 365.0,
        routers: Sequence[str] = (),
    ) -> Identity:
        """Issue a new identity with a new key."""
        key = new_key(self.algorithm)
        with self._changing():
            certificate = self._certify(self._free(name), key.public_key(), role, rights, days)
            return self._identity(certificate, key, role, routers)

    def sign_request(
        self,
        csr: bytes,
        *,
        role: str = "member",
        rights: Rights | None = None,
        days: float = 365.0,
        routers: Sequence[str] = (),
    ) -> str:
        """Issue a bundle without a key, for a machine that made its own. Raises ``IdentityError`` for a bad request."""
        with understood("the request", "it is not a certificate signing request", "; ropeway keys request makes one"):
            request = x509.load_pem_x509_csr(csr)
            good = request.is_signature_valid
            key, name = request.public_key(), common_name(request.subject)
        if not isinstance(key, (Ed25519PublicKey, RSAPublicKey)):
            raise IdentityError("the request", "its key is neither Ed25519 nor RSA; ropeway keys request makes one")
        if not good:
            raise IdentityError("the request", "its signature does not match its key")
        secret = self.name_secret if role == "member" else None
        with self._changing():
            certificate = self._certify(self._free(name), key, role, rights, days)
            return bundle_text(
                certificate, self.ca, secret, self._routers(routers), self.crl_der(), key=None, fleet=self.name
            )

    def renew(self, name: str, *, days: float = 365.0) -> Identity:
        """Issue a new key and certificate to a member, with its present rights; the old certificate stays valid until
        it ends.
        """
        key = new_key(self.algorithm)
        with self._changing():
            row = self._row(name)
            if row.get("revoked"):
                raise IdentityError(name, "it is revoked; issue it anew with: ropeway keys issue")
            rights = Rights(**{verb: tuple(patterns) for verb, patterns in row["rights"].items()})
            certificate = self._certify(name, key.public_key(), row["role"], rights, days)
            return self._identity(certificate, key, row["role"], tuple(row.get("routers", ())))

    def revoke(self, name: str) -> list[int]:
        """Revoke every certificate of a name; the serial numbers. The list has to reach the others (``--push``)."""
        with self._changing():
            self._row(name)
            issued = self._record["issued"]
            serials = [row["serial"] for row in issued if row["name"] == name and not row.get("revoked")]
            if not serials:
                raise IdentityError(name, "it is revoked already; to tell the overlay again, use --push BUNDLE")
            for row in issued:
                if row["name"] == name:
                    row["revoked"] = True
            self._renew_crl({*(entry.serial_number for entry in self.crl), *serials})
            self._save()
            return serials

    def is_revoked(self, name: str) -> bool:
        """Return whether every certificate of a name is revoked. Raises ``IdentityError`` where it never had one."""
        self._row(name)
        return all(row.get("revoked") for row in self._record["issued"] if row["name"] == name)

    def _renew_crl(self, serials: Collection[int]) -> None:
        number = self.crl.extensions.get_extension_for_class(x509.CRLNumber).value.crl_number
        alive = {row["name"] for row in self._record["issued"] if not row.get("revoked")}
        denied = sorted({row["name"] for row in self._record["issued"]} - alive)
        self.crl = _crl(self.ca, self._key, number + 1, serials, denied)
        write_durable(self.directory / "crl.pem", self.crl.public_bytes(Encoding.PEM))

    def _free(self, name: str) -> str:
        valid_name(name)
        if any(row["name"] == name and not row.get("revoked") for row in self._record["issued"]):
            raise IdentityError(name, "it has a certificate already; renew it, or revoke it first")
        return name

    def _row(self, name: str) -> dict[str, Any]:
        rows = [row for row in self._record["issued"] if row["name"] == name]
        if not rows:
            known = ", ".join(dict.fromkeys(row["name"] for row in self._record["issued"])) or "nobody yet"
            raise IdentityError(name, f"nothing was issued to it; issued to: {known}")
        row: dict[str, Any] = rows[-1]
        return row

    def _identity(self, certificate: Certificate, key: PrivateKey, role: str, routers: Sequence[str]) -> Identity:
        secret = self.name_secret if role == "member" else None
        return Identity(certificate, key, self.ca, secret, self._routers(routers), self.crl_der())

    def _routers(self, routers: Sequence[str]) -> tuple[str, ...]:
        return tuple(routers) or self.routers

    def crl_der(self) -> bytes:
        """Return the revocation list, for the overlay."""
        return self.crl.public_bytes(Encoding.DER)

    def _certify(self, name: str, key: Any, role: str, rights: Rights | None, days: float) -> Certificate:
        now = datetime.datetime.now(datetime.timezone.utc)
        rights = rights or EVERYTHING
        purpose = MEMBER if role == "member" else ROUTER
        uses = [ExtendedKeyUsageOID.SERVER_AUTH, ExtendedKeyUsageOID.CLIENT_AUTH, purpose]
        built = (
            x509.CertificateBuilder()
            .subject_name(
                x509.Name(
                    [
                        x509.NameAttribute(NameOID.ORGANIZATION_NAME, self.name),
                        x509.NameAttribute(NameOID.COMMON_NAME, name),
                    ]
                )
            )
            .issuer_name(self.ca.subject)
            .public_key(key)
            .serial_number(x509.random_serial_number())
            .not_valid_before(now - _BACKDATED)
            .not_valid_after(now + datetime.timedelta(days=days))
            .add_extension(x509.BasicConstraints(False, None), critical=True)
            .add_extension(_usage(authority=False), critical=True)
            .add_extension(x509.ExtendedKeyUsage(uses), critical=False)
            .add_extension(x509.SubjectAlternativeName([x509.DNSName(name)]), critical=False)
            .add_extension(_issued_by(self.ca), critical=False)
        )
        if role == "member":
            built = built.add_extension(x509.UnrecognizedExtension(RIGHTS, rights.to_json()), critical=False)
        certificate = Certificate(built.sign(self._key, _hash(self._key)).public_bytes(Encoding.DER))
        self._record["issued"].append(
            {
                "name": name,
                "role": role,
                "serial": certificate.serial,
                "not_after": certificate.not_after.isoformat(),
                "rights": json.loads(rights.to_json()) if role == "member" else {},
            }
        )
        if any(row["name"] == name and row.get("revoked") for row in self._record["issued"]):
            self._renew_crl([entry.serial_number for entry in self.crl])  # the name is in use again
        self._save()
        return certificate

    def _save(self) -> None:
        write_durable(self.directory / "fleet.json", _json(self._record))


def make_request(name: str, key: PrivateKey) -> str:
    """Make a certificate signing request for a machine that keeps its key, as PEM. Raises ``IdentityError``."""
    subject = x509.Name([x509.NameAttribute(NameOID.COMMON_NAME, valid_name(name))])
    made = x509.CertificateSigningRequestBuilder().subject_name(subject).sign(key, _hash(key))
    return made.public_bytes(Encoding.PEM).decode()


def _read_record(directory: Path) -> dict[str, Any]:
    """Return what ``fleet.json`` says. Raises ``OSError``, and ``ValueError`` for what this module never writes."""
    found: Any = json_value((directory / "fleet.json").read_bytes())
    rows = found.get("issued") if isinstance(found, dict) else None
    if not isinstance(rows, list) or not _texts(found.get("routers")) or not all(map(_is_row, rows)):
        raise ValueError("fleet.json does not say what was issued")
    return dict(found)


def _is_row(row: object) -> bool:
    return (
        isinstance(row, dict)
        and _texts([row.get(key) for key in ("name", "role", "not_after")])
        and type(row.get("serial")) is int
        and isinstance(row.get("rights"), dict)
        and all(verb in VERBS and _texts(patterns) for verb, patterns in row["rights"].items())
        and _texts(row.get("routers", []))
    )


def _texts(value: object) -> bool:
    return isinstance(value, list) and all(isinstance(text, str) for text in value)


def _json(record: Mapping[str, Any]) -> bytes:
    return (json.dumps(record, indent=1) + "\n").encode()


def _hash(key: PrivateKey) -> hashes.SHA256 | None:
    return None if isinstance(key, Ed25519PrivateKey) else hashes.SHA256()


def _usage(*, authority: bool) -> x509.KeyUsage:
    return x509.KeyUsage(
        digital_signature=not authority,
        content_commitment=False,
        key_encipherment=False,
        data_encipherment=False,
        key_agreement=False,
        key_cert_sign=authority,
        crl_sign=authority,
        encipher_only=False,
        decipher_only=False,
    )


def _issued_by(ca: x509.Certificate) -> x509.AuthorityKeyIdentifier:
    """Return the extension that names the authority's key, which strict verifiers ask for (Python since 3.13)."""
    return x509.AuthorityKeyIdentifier.from_issuer_public_key(ca.public_key())  # type: ignore[arg-type]


def _crl(
    ca: x509.Certificate, key: PrivateKey, number: int, serials: Collection[int], denied: Sequence[str] = ()
) -> x509.CertificateRevocationList:
    now = datetime.datetime.now(datetime.timezone.utc)
    built = (
        x509.CertificateRevocationListBuilder()
        .issuer_name(ca.subject)
        .last_update(now - _BACKDATED)
        .next_update(now + datetime.timedelta(days=_CRL_DAYS))
        .add_extension(x509.CRLNumber(number), critical=False)
        .add_extension(_issued_by(ca), critical=False)
        .add_extension(x509.UnrecognizedExtension(DENIED, json.dumps(list(denied)).encode()), critical=False)
    )
    for serial in serials:
        entry = x509.RevokedCertificateBuilder().serial_number(serial).revocation_date(now - _BACKDATED).build()
        built = built.add_revoked_certificate(entry)
    return built.sign(key, _hash(key))
