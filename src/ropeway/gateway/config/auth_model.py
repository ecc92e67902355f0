"""The part of a configuration that says who may do what: ``gateway.auth``, ``gateway.globs``, and tokens of remotes."""

from __future__ import annotations

import re
from collections.abc import Mapping
from typing import Annotated, Any, Final, Literal

from pydantic import (
    AfterValidator,
    AliasChoices,
    BeforeValidator,
    Field,
    PlainSerializer,
    PlainValidator,
    WithJsonSchema,
    model_validator,
)

from ropeway.gateway.config.fields import ExistingPath, Many, Model
from ropeway.gateway.config.suggest import show

__all__ = [
    "ALL",
    "VERB_OF_KEY",
    "AuthConfig",
    "CertificateItem",
    "GlobsConfig",
    "Patterns",
    "RoleConfig",
    "Secret",
    "TokenItem",
    "parse_glob",
]

ALL: Final = "all"
"""The role that may do everything, there without being listed."""

VERB_OF_KEY: Final[Mapping[str, str]] = {
    "publish": "publish",
    "subscribe": "subscribe",
    "call": "call_service",
    "serve": "advertise_service",
    "send_goal": "send_action_goal",
    "serve_action": "advertise_action",
}
"""The keys of a role, and the verb of ``ropeway.listener.authorization`` that each stands for."""

_HASH: Final = re.compile(r"sha256:(?:[^:]*:)?[0-9a-fA-F]{64}")
_FINGERPRINT: Final = re.compile(r"(?:[0-9a-f]{2}:?){31}[0-9a-f]{2}")


def parse_glob(value: object) -> tuple[str, ...] | None:
    """Parse a glob of rosbridge: ``"['/a', '/b*']"``, the same as a list, ``""`` for no filter.

    Raises ``ValueError`` for anything else.
    """
    if value is None or (isinstance(value, str) and not value.strip()):
        return None
    wanted = ValueError(f"""expected a list of patterns such as "['/camera/*', '/odom']", got {show(value)}""")
    if isinstance(value, str):
        text = value.strip()
        if not (text.startswith("[") and text.endswith("]")):
            raise wanted
        value = [part.strip().strip("'\"").strip() for part in text[1:-1].split(",")]
    if not isinstance(value, list | tuple) or not all(isinstance(item, str) for item in value):
        raise wanted
    return tuple(item for item in value if item)


def _reference(value: object) -> object:
    if isinstance(value, str):  # which must not be shown: it is the token
        raise ValueError('expected {"env": "NAME"} or {"file": "PATH"}: a token itself is not written here')
    return value


def _no_token(value: object) -> object:
    if isinstance(value, str):
        raise ValueError('expected an object such as {"token": {"env": "NAME"}}: a token itself is not written here')
    return value


def _hash(value: str) -> str:
    if not _HASH.fullmatch(value):
        raise ValueError("expected sha256:<64 hexadecimal digits>, or sha256:<salt>:<64 hexadecimal digits>")
    return value


def _fingerprint(value: str) -> str:
    if not _FINGERPRINT.fullmatch(value.lower()):
        raise ValueError(f"expected the SHA-256 of a certificate, 64 hexadecimal digits, got {show(value)}")
    return value.lower().replace(":", "")


def _pattern(value: str) -> str:
    if not value or any(c.isspace() for c in value):
        raise ValueError(f"expected a name or a pattern such as /camera/*, got {show(value)}")
    return value


Pattern = Annotated[str, AfterValidator(_pattern)]
Rate = Annotated[float, Field(gt=0, allow_inf_nan=False)]
Glob = Annotated[
    tuple[str, ...] | None,
    PlainValidator(parse_glob),
    PlainSerializer(lambda glob: glob if glob is None else list(glob)),
    WithJsonSchema({"anyOf": [{"type": "string"}, {"type": "array", "items": {"type": "string"}}, {"type": "null"}]}),
]


class _Secret(Model):
    """Says where a token is read from when the gateway starts."""

    env: str | None = Field(None, min_length=1, description="the name of an environment variable")
    file: ExistingPath | None = Field(None, description="a file that holds it and nothing else")

    @model_validator(mode="after")
    def _one(self) -> _Secret:
        if (self.env is None) == (self.file is None):
            raise ValueError('expected either "env" or "file"')
        return self


Secret = Annotated[_Secret, BeforeValidator(_reference)]


class TokenItem(Model):
    """A bearer token and what it stands for."""

    token: Secret | None = Field(None, description='where it is: {"env": "NAME"} or {"file": "PATH"}')
    hash: Annotated[str, AfterValidator(_hash)] | None = Field(
        None, description="or its hash: sha256:<hex of the token's>, or sha256:<salt>:<hex of salt and token>"
    )
    role: str = Field(ALL, description="one of auth.roles; default: all")

    @model_validator(mode="after")
    def _one(self) -> TokenItem:
        if (self.token is None) == (self.hash is None):
            raise ValueError('expected either "token" or "hash"')
        return self


class CertificateItem(Model):
    """Certificates of clients and what they stand for; all patterns that are given must fit."""

    common_name: Pattern | None = Field(None, description="pattern for the CN of the subject")
    san: Pattern | None = Field(None, description="pattern for any alternative name: host, address, URI, mail")
    fingerprint: Annotated[str, AfterValidator(_fingerprint)] | None = Field(None, description="its SHA-256, in hex")
    role: str = Field(ALL, description="one of auth.roles; default: all")

    @model_validator(mode="after")
    def _some(self) -> CertificateItem:
        if self.common_name is None and self.san is None and self.fingerprint is None:
            raise ValueError('expected "common_name", "san" or "fingerprint"')
        return self


class Patterns(Model):
    """Lists name patterns by verb; ``*`` also stands for slashes."""

    publish: Many[Pattern] = Field((), description="topics that may be published")
    subscribe: Many[Pattern] = Field((), description="topics that may be read")
    call: Many[Pattern] = Field(
        (), validation_alias=AliasChoices("call", "call_service"), description="services that may be called"
    )
    serve: Many[Pattern] = Field(
        (), validation_alias=AliasChoices("serve", "advertise_service"), description="services that may be offered"
    )
    send_goal: Many[Pattern] = Field(
        (), validation_alias=AliasChoices("send_goal", "send_action_goal"), description="actions that may be used"
    )
    serve_action: Many[Pattern] = Field(
        (), validation_alias=AliasChoices("serve_action", "advertise_action"), description="actions that may be offered"
    )

    def by_verb(self) -> dict[str, tuple[str, ...]]:
        """Return the patterns by verb, as ``ropeway.listener.authorization.Role`` holds them."""
        return {verb: getattr(self, key) for key, verb in VERB_OF_KEY.items() if getattr(self, key)}


class RoleConfig(Patterns):
    """The rights of a role's clients; whatever is not listed is not allowed."""

    deny: Patterns = Field(
        default_factory=dict, validate_default=True, description="exceptions from the patterns beside it"
    )
    messages_per_s: Rate | None = Field(None, description="how much a client may send; default: no limit")
    bytes_per_s: Rate | None = Field(None, description="how much a client may send; default: no limit")
    max_message_bytes: int | None = Field(None, ge=1024, description="a longer message closes its connection")
    max_clients: int | None = Field(None, ge=0, description="how many clients may have the role at a time")
    control: Many[Literal["observe", "configure", "operate"]] = Field(
        (), description="what it may do at the control API: see, change the configuration, act on sessions"
    )


class AuthConfig(Model):
    """Says who may connect, and in which role."""

    tokens: Annotated[Many[Annotated[TokenItem, BeforeValidator(_no_token)]], BeforeValidator(_no_token)] = Field(
        (), description="bearer tokens"
    )
    certificates: Many[CertificateItem] = Field((), description="certificates of clients; needs tls.ca")
    roles: dict[str, RoleConfig] = Field({}, description="what each may do, by name")
    default_role: str | None = Field(
        None, description="the role of clients without token and certificate; default: they may not connect"
    )
    origins: Many[Pattern] | None = Field(
        None,
        description="web pages whose scripts may connect, such as https://*.example.com, null for files that are "
        "opened in a browser, or * for all; default: pages of the same machine as the browser, or as the gateway",
    )
    hosts: Many[Pattern] = Field(
        (),
        description="names by which clients without a token reach the listeners, beside those of the machine and of "
        "its certificate, such as robot.example.com; * for any",
    )

    @property
    def asks(self) -> bool:
        """Whether credentials are asked for."""
        return bool(self.tokens or self.certificates)


def _glob(name: str, description: str) -> Any:
    return Field(None, validation_alias=AliasChoices(name, f"{name}_glob"), description=description)


class GlobsConfig(Model):
    """rosbridge's globs, for every client whatever its role; ``""`` filters nothing, ``[]`` allows nothing."""

    topics: Glob = _glob("topics", "added to topics_pub and topics_sub")
    topics_pub: Glob = _glob("topics_pub", "topics that may be published")
    topics_sub: Glob = _glob("topics_sub", "topics that may be read")
    services: Glob = _glob("services", "services that may be called or offered; those of rosapi always are")
    actions: Glob = _glob("actions", "actions that may be used or offered")
    params: Glob = _glob("params", "parameters that rosapi shows and sets")
