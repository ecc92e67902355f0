"""Models of TLS in a configuration, towards remotes and at listeners."""

from __future__ import annotations

from typing import Literal

from pydantic import Field

from ropeway.gateway.config.fields import ExistingPath, Model

__all__ = ["ListenTls", "RemoteTls"]


class RemoteTls(Model):
    """TLS towards one remote."""

    ca: ExistingPath | None = Field(None, description="file of the authorities to trust instead of the system's")
    certificate: ExistingPath | None = Field(None, description="this gateway's own certificate, where the remote asks")
    key: ExistingPath | None = Field(None, description="the key of the certificate")
    verify: bool = Field(True, description="false accepts any certificate: for tests only")


class ListenTls(Model):
    """TLS of the listeners."""

    certificate: ExistingPath = Field(description="certificate chain, PEM")
    key: ExistingPath = Field(description="its private key, PEM")
    ca: ExistingPath | None = Field(None, description="clients must show a certificate of these authorities")
    crl: ExistingPath | None = Field(
        None, description="with ca: list of the certificates that their authorities revoked, PEM"
    )
    client_certificates: Literal["required", "optional"] = Field(
        "required", description="with ca: whether a client without a certificate may connect with a token"
    )
