"""TLS contexts of both roles, made from the configuration."""

from __future__ import annotations

import ssl

from ropeway.errors import ConfigError
from ropeway.gateway.model import ListenTls, RemoteTls

__all__ = ["client_context", "reload_server_context", "server_context"]


def server_context(tls: ListenTls | None) -> ssl.SSLContext | None:
    """For listeners; with ``ca`` clients are asked for a certificate. Raises ``ConfigError``."""
    if tls is None:
        return None
    context = ssl.SSLContext(ssl.PROTOCOL_TLS_SERVER)
    context.minimum_version = ssl.TLSVersion.TLSv1_2
    _load(context, "gateway.tls", tls.certificate, tls.key)
    if tls.ca is not None:
        _trust(context, "gateway.tls", tls.ca)
        context.verify_mode = ssl.CERT_REQUIRED if tls.client_certificates == "required" else ssl.CERT_OPTIONAL
    return context


def reload_server_context(context: ssl.SSLContext, tls: ListenTls) -> None:
    """Read the files again, for connections to come; authorities are added, none is taken away.

    Raises ``ConfigError`` if they are no good; the context then stays as it was.
    """
    server_context(tls)
    context.load_cert_chain(tls.certificate, tls.key)
    if tls.ca is not None:
        context.load_verify_locations(tls.ca)


def client_context(tls: RemoteTls | None, path: str) -> ssl.SSLContext | None:
    """For one remote; ``path`` is where the configuration names it. Raises ``ConfigError``."""
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


def _load(context: ssl.SSLContext, path: str, certificate: str, key: str | None) -> None:
    try:
        context.load_cert_chain(certificate, key)
    except (OSError, ssl.SSLError) as error:
        text = f"the certificate {certificate} and its key {key} do not go together: {error}"
        raise ConfigError([(path, text)]) from None
