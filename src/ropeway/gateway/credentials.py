"""Loads what a gateway presents to its remotes, and whom it trusts there; both are read again at SIGHUP."""

from __future__ import annotations

import logging
import ssl
from dataclasses import dataclass, field

from ropeway.gateway.auth import read_secret
from ropeway.gateway.config.address import is_loopback, is_secure
from ropeway.gateway.config.model import RemoteConfig
from ropeway.gateway.tls import client_context, trusted_files
from ropeway.listener.http import without_token

__all__ = ["Credentials", "read_credentials"]

log = logging.getLogger("ropeway.gateway")


@dataclass(frozen=True)
class Credentials:
    """The credentials for one remote. ``trusted`` is a digest of the authorities whose certificates it may show.

    ``password`` is that of the user of a broker.
    """

    context: ssl.SSLContext | None = None
    token: str | None = field(default=None, repr=False)
    trusted: bytes = b""
    password: str | None = field(default=None, repr=False)

    @property
    def headers(self) -> dict[str, str]:
        """Return what a handshake shows."""
        return {} if self.token is None else {"Authorization": f"Bearer {self.token}"}


def read_credentials(remote: RemoteConfig, index: int) -> Credentials:
    """Read the files and variables that the configuration names. Raises ``ConfigError``."""
    path, secure = f"remotes[{index}]", is_secure(remote.address)
    token = None if remote.token is None else read_secret(remote.token, f"{path}.token")
    if token is not None and not secure and not all(map(is_loopback, remote.addresses)):
        shown = without_token(remote.address)
        log.warning("%s: the token is sent unencrypted; %s:// would encrypt it", shown, f"{shown.partition(':')[0]}s")
    password = None if remote.password is None else read_secret(remote.password, f"{path}.password")
    if password is not None and not secure and not is_loopback(remote.address):
        log.warning("%s: the password is sent unencrypted; mqtts:// would encrypt it", remote.address.partition("?")[0])
    context = client_context(remote.tls, f"{path}.tls") if secure else None
    return Credentials(context, token, trusted_files(remote.tls), password)
