"""Makes the door of the server from the configuration, and reads the tokens that it refers to."""

from __future__ import annotations

import logging
import os
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Final
from urllib.parse import urlsplit

from ropeway.errors import ConfigError
from ropeway.gateway.config.address import is_loopback, is_secure
from ropeway.gateway.config.auth_model import ALL, AuthConfig, GlobsConfig, RoleConfig, Secret
from ropeway.gateway.config.model import GatewayConfig
from ropeway.gateway.tls import certificate_names
from ropeway.listener.authentication import CertificateRule, Door, TokenRule
from ropeway.listener.authorization import EVERYTHING, Globs, Role
from ropeway.listener.hosts import Hosts, host_of, own_names

__all__ = ["make_door", "read_secret", "warn_of_tokens"]

log = logging.getLogger("ropeway.gateway")

_LONGEST: Final = 4096  # characters of a token: it has to fit the head of a request


def make_door(settings: GatewayConfig) -> Door:
    """Build the rules for who may come in, and in which role. Raises ``ConfigError`` where a token cannot be read."""
    auth = settings.auth
    audit = settings.audit
    everything = replace(EVERYTHING, audited=audit.audited(ALL)) if audit.audited(ALL) else EVERYTHING
    roles = {ALL: everything, **{name: _role(name, role, audit.audited(name)) for name, role in auth.roles.items()}}
    default = roles[auth.default_role] if auth.default_role is not None else None
    return Door(
        tokens=[_token(auth, index, roles) for index in range(len(auth.tokens))],
        certificates=[
            CertificateRule(roles[item.role], item.common_name or "", item.san or "", item.fingerprint or "")
            for item in auth.certificates
        ],
        default=default if default is not None or auth.asks else everything,
        hosts=_hosts(settings),
        globs=_globs(settings.globs),
        max_clients=settings.clients.max_clients,
    )


def read_secret(secret: Secret, path: str) -> str:
    """Read the token that ``secret`` refers to; ``path`` is its place in the configuration. Raises ``ConfigError``."""
    if secret.env is not None:
        where, text = f"{path}.env", os.environ.get(secret.env)
        if text is None:
            raise ConfigError([(where, f"the environment variable {secret.env} is not set")])
    else:
        assert secret.file is not None
        where = f"{path}.file"
        try:
            text = Path(secret.file).read_text(encoding="ascii")
        except OSError as error:
            raise ConfigError([(where, f"{secret.file} cannot be read: {error.strerror or error}")]) from None
        except UnicodeDecodeError:
            raise ConfigError([(where, f"{secret.file} holds no token: it is not ASCII text")]) from None
    token = text.strip()
    if not token or len(token) > _LONGEST or not all("!" <= c <= "~" for c in token):
        raise ConfigError([(where, f"expected 1 to {_LONGEST} printable ASCII characters without a space")])
    return token


def warn_of_tokens(settings: GatewayConfig, url: str) -> None:
    """Say that tokens can be read on their way to a listener that other machines reach without TLS."""
    if settings.auth.tokens and not is_secure(url) and not is_loopback(url):
        log.warning("%s: tokens are sent unencrypted here; %ss:// would encrypt them", url, urlsplit(url).scheme)


def _hosts(settings: GatewayConfig) -> Hosts:
    """Return the names under which the listeners are reached: the machine's, theirs, and those of the certificate."""
    listeners = {host_of(urlsplit(url).netloc) for url in settings.listen}
    certified = certificate_names(settings.tls) if settings.tls is not None else frozenset()
    wild = {name for name in certified if "*" in name}
    patterns = (*wild, *(pattern.lower() for pattern in settings.auth.hosts))
    return Hosts(own_names() | listeners | (certified - wild), patterns, settings.auth.origins)


def _token(auth: AuthConfig, index: int, roles: Mapping[str, Role]) -> TokenRule:
    item = auth.tokens[index]
    if item.hash is not None:
        return TokenRule.hashed(item.hash, roles[item.role])
    assert item.token is not None
    return TokenRule.plain(read_secret(item.token, f"gateway.auth.tokens[{index}].token"), roles[item.role])


def _role(name: str, config: RoleConfig, audited: tuple[str, ...]) -> Role:
    return Role(
        name,
        config.by_verb(),
        config.deny.by_verb(),
        messages_per_s=config.messages_per_s,
        bytes_per_s=config.bytes_per_s,
        max_message_bytes=config.max_message_bytes,
        max_clients=config.max_clients,
        control=frozenset(config.control),
        audited=audited,
    )


def _globs(config: GlobsConfig) -> Globs:
    def topics(own: tuple[str, ...] | None) -> tuple[str, ...] | None:
        return own if config.topics is None else (*(own or ()), *config.topics)

    return Globs(
        topics_pub=topics(config.topics_pub),
        topics_sub=topics(config.topics_sub),
        services=config.services,
        params=config.params,
        actions=config.actions,
    )
