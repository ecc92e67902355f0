"""TLS contexts of both roles, made from the configuration."""

from __future__ import annotations

import contextlib
import hashlib
import ssl
from pathlib import Path

from ropeway.errors import ConfigError
from ropeway.gateway.config.tls_model import ListenTls, RemoteTls

__all__ = ["certificate_names", "client_context", "server_context", "trusted_files"]


def server_context(tls: ListenTls | None) -> ssl.SSLContext | None:
    """Return a context for listeners; with ``ca`` clients are asked for a certificate. Raises ``ConfigError``."""
    if tls is None:
        return None
    context = ssl.SSLContext(ssl.PROTOCOL_TLS_SERVER)
    context.minimum_version = ssl.TLSVersion.TLSv1_2
    _load(context, "gateway.tls", tls.certificate, tls.key)
    if tls.ca is not None:
        _trust(context, "gateway.tls", tls.ca)
        context.verify_mode = ssl.CERT_REQUIRED if tls.client_certificates == "required" else ssl.CERT_OPTIONAL
    if tls.crl is not None:
        _revoke(context, "gateway.tls", tls.crl)
    return context


def certificate_names(tls: ListenTls) -> frozenset[str]:
    """Return the host names and addresses that the certificate of the listeners is for, in lower case.

    Empty for a certificate that cannot be read, which ``server_context`` tells.
    """
    from cryptography import x509  # takes longer to load than a gateway without TLS should wait

    try:
        certificate = x509.load_pem_x509_certificate(Path(tls.certificate).read_bytes())
        names = certificate.extensions.get_extension_for_class(x509.SubjectAlternativeName).value
    except Exception:  # of a library that reads what others wrote, which raises many kinds
        return frozenset()
    hosts = [*names.get_values_for_type(x509.DNSName), *map(str, names.get_values_for_type(x509.IPAddress))]
    return frozenset(host.lower() for host in hosts)


def trusted_files(tls: ListenTls | RemoteTls | None) -> bytes:
    """Return what decides whose certificates are good: a digest of the authorities and of those they revoked."""
    digest = hashlib.sha256()
    for path in () if tls is None else (tls.ca, tls.crl if isinstance(tls, ListenTls) else None):
        with contextlib.suppress(OSError):
            digest.update(b"" if path is None else Path(path).read_bytes())
    return digest.digest()


def client_context(tls: RemoteTls | None, path: str) -> ssl.SSLContext | None:
    """Make the TLS context for one remote; ``path`` is its place in the configuration. Raises ``ConfigError``."""
    if tls is None:
        return None
    if tls.ca is None:
        context = ssl.create_default_context()
    else:
        context = ssl.SSLContext(ssl.PROTOCOL_TLS_CLIENT)
        _trust(context, path, tls.ca)
    context.minimum_version = ssl.TLSVersion.TLSv1_2
    if not tls.verify:
        context.check_hostname = False
        context.verify_mode = ssl.CERT_NONE
    if tls.certificate is not None:
        _load(context, path, tls.certificate, tls.key)
    return context


def _trust(context: ssl.SSLContext, path: str, ca: str) -> None:
    try:
        context.load_verify_locations(ca)
    except (OSError, ssl.SSLError) as error:
        raise ConfigError([(f"{path}.ca", f"{ca} holds no certificates in PEM: {error}")]) from None


def _revoke(context: ssl.SSLContext, path: str, crl: str) -> None:
    try:
        context.load_verify_locations(crl)
    except (OSError, ssl.SSLError) as error:
        raise ConfigError([(f"{path}.crl", f"{crl} holds no list of revoked certificates in PEM: {error}")]) from None
    context.verify_flags |= ssl.VerifyFlags.VERIFY_CRL_CHECK_LEAF


def _load(context: ssl.SSLContext, path: str, certificate: str, key: str | None) -> None:
    try:
        context.load_cert_chain(certificate, key)
    except (OSError, ssl.SSLError) as error:
        text = f"the certificate {certificate} and its key {key} do not go together: {error}"
        raise ConfigError([(path, text)]) from None
