"""The door of the server: who a client is, by token or certificate, and whether it may come in at all."""

from __future__ import annotations

import fnmatch
import hashlib
import hmac
import re
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import Any, Final
from urllib.parse import unquote

from ropeway.link.http import Request, Response, reply
from ropeway.server.access import EVERYTHING, Globs, Role
from ropeway.wire.dialect import ROPEWAY_SUBPROTOCOL

__all__ = [
    "BEARER",
    "PLAIN_SUBPROTOCOL",
    "CertificateRule",
    "Door",
    "TokenRule",
    "given_token",
    "subprotocol",
    "unserved",
]

BEARER: Final = "bearer."
"""A subprotocol that begins so carries a token: a browser can send no header of its own."""

PLAIN_SUBPROTOCOL: Final = "rosbridge"
"""A browser that sends its token as a subprotocol may offer this one, too, to be answered without the token."""

_HASH: Final = re.compile(r"sha256:(?:([^:]*):)?([0-9a-fA-F]{64})")


@dataclass(frozen=True)
class TokenRule:
    """A token and the role of who has it. Only ``sha256(salt + token)`` is kept."""

    digest: bytes
    role: Role
    salt: bytes = b""

    @classmethod
    def plain(cls, token: str, role: Role) -> TokenRule:
        """Of the token itself."""
        return cls(hashlib.sha256(token.encode()).digest(), role)

    @classmethod
    def hashed(cls, text: str, role: Role) -> TokenRule:
        """Of ``sha256:<hex>`` or ``sha256:<salt>:<hex>``. Raises ``ValueError``."""
        match = _HASH.fullmatch(text)
        if match is None:
            raise ValueError("expected sha256:<64 hexadecimal digits>, or sha256:<salt>:<64 hexadecimal digits>")
        return cls(bytes.fromhex(match[2]), role, (match[1] or "").encode())

    def fits(self, token: str) -> bool:
        """True for the token; takes the same time for all others."""
        digest = hashlib.sha256(self.salt + token.encode(errors="surrogateescape")).digest()
        return hmac.compare_digest(digest, self.digest)


@dataclass(frozen=True)
class CertificateRule:
    """Certificates and the role of who shows one; every pattern that is not empty must fit.

    ``common_name`` is that of the subject, ``san`` any alternative name (host, address, URI, mail), ``fingerprint`` the
    SHA-256 of the certificate in hexadecimal digits, with colons or without.
    """

    role: Role
    common_name: str = ""
    san: str = ""
    fingerprint: str = ""

    def fits(self, request: Request) -> bool:
        """True if the certificate of the client, which TLS has verified, is one of these."""
        certificate = request.certificate
        if not certificate:
            return False
        if self.fingerprint and request.fingerprint != self.fingerprint.replace(":", "").lower():
            return False
        if self.common_name and not _any_fits(_common_names(certificate), self.common_name):
            return False
        alternatives = [str(value) for _, value in certificate.get("subjectAltName", ())]
        return not self.san or _any_fits(alternatives, self.san)


@dataclass(frozen=True)
class Door:
    """Gives every client a role, or refuses it.

    ``default`` is the role of a client without credentials, ``None`` refuses it. ``origins`` are patterns of the
    web pages whose scripts may connect (``None``: all); programs that are no browser send no origin, and may.
    ``max_clients`` bounds how many clients there are at a time.
    """

    tokens: Sequence[TokenRule] = ()
    certificates: Sequence[CertificateRule] = ()
    default: Role | None = EVERYTHING
    origins: Sequence[str] | None = None
    globs: Globs = Globs()  # noqa: RUF009 - frozen
    max_clients: int | None = None

    @property
    def asks(self) -> bool:
        """True if credentials count for something here."""
        return bool(self.tokens or self.certificates)

    def role_of(self, request: Request) -> Role | Response:
        """The role of who sent this, or the answer that refuses it: 401 without good credentials, 403 by origin."""
        if not self.knows_origin(request.headers.get("origin", "")):
            return reply(403, {"error": "web pages of this origin may not connect; gateway.auth.origins names those"})
        if not self.asks:
            return self.default or _who_are_you("this server knows no credentials that would let anybody in")
        tokens = given_token(request)
        if tokens and self.tokens:
            found = [rule.role for rule in self.tokens for token in tokens if rule.fits(token)]
            return found[0] if found else _who_are_you("the token is not known here", ', error="invalid_token"')
        for rule in self.certificates:
            if rule.fits(request):
                return rule.role
        return self.default or _who_are_you("a token or a certificate is needed")

    def knows_origin(self, origin: str) -> bool:
        """True if a page of this origin may connect; ``""`` is no page."""
        return not origin or self.origins is None or _any_fits([origin.lower()], *(o.lower() for o in self.origins))


def given_token(request: Request) -> list[str]:
    """What a client gives as its token: by header, subprotocol or query, in this order; different readings of one."""
    scheme, _, value = request.headers.get("authorization", "").partition(" ")
    if scheme.lower() == "bearer" and value.strip():
        return [value.strip()]
    for offered in request.subprotocols:
        if offered.startswith(BEARER) and len(offered) > len(BEARER):
            text = offered.removeprefix(BEARER)
            return list(dict.fromkeys((text, unquote(text))))
    query = request.query
    return [*query.get("token", ()), *query.get("access_token", ())][:1]


def subprotocol(request: Request) -> str:
    """What a client that is let in is told: ours, ``rosbridge``, or what carried its token; browsers insist on one."""
    offered = request.subprotocols
    for known in (ROPEWAY_SUBPROTOCOL, PLAIN_SUBPROTOCOL):
        if known in offered:
            return known
    return next((name for name in offered if name.startswith(BEARER)), "")


def unserved(request: Request) -> str:
    """Return why a client cannot be served that insists on subprotocols of others; ``""`` where it does not.

    A browser ends a connection for which none of those is chosen that it offered, and gives no reason.
    """
    if not request.subprotocols or subprotocol(request):
        return ""
    return (  # what was offered is not repeated: a token may be among it
        f"none of the subprotocols offered is served here, but {PLAIN_SUBPROTOCOL}, {ROPEWAY_SUBPROTOCOL} and none at "
        "all (which is rosbridge) are; in a viewer, open a rosbridge connection"
    )


def _who_are_you(text: str, detail: str = "") -> Response:
    return reply(401, {"error": text}, WWW_Authenticate=f'Bearer realm="ropeway"{detail}')


def _common_names(certificate: Any) -> list[str]:
    return [value for part in certificate.get("subject", ()) for key, value in part if key == "commonName"]


def _any_fits(values: Iterable[str], *patterns: str) -> bool:
    return any(fnmatch.fnmatchcase(value, pattern) for value in values for pattern in patterns)
