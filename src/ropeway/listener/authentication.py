"""Authenticates clients, by token or certificate, and decides whether they may come in at all."""

from __future__ import annotations

import fnmatch
import hashlib
import hmac
import json
import re
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from typing import Any, Final
from urllib.parse import unquote

from ropeway.limits import SHOWN_TEXT_CHARACTERS
from ropeway.listener.authorization import EVERYTHING, Globs, Role
from ropeway.listener.hosts import Hosts, host_of
from ropeway.listener.http import HttpRequest, Response, reply
from ropeway.listener.subprotocols import GATEWAY_SUBPROTOCOLS, PLAIN_SUBPROTOCOL

__all__ = [
    "BEARER",
    "CertificateRule",
    "Door",
    "Rejection",
    "TokenRule",
    "given_token",
    "refusal",
    "subprotocol",
    "unserved",
]

BEARER: Final = "bearer."
"""A subprotocol that begins so carries a token: a browser can send no header of its own."""

_HASH: Final = re.compile(r"sha256:(?:([^:]*):)?([0-9a-fA-F]{64})")


@dataclass(frozen=True)
class TokenRule:
    """Gives the holders of a token their role. Only ``sha256(salt + token)`` is kept."""

    digest: bytes
    role: Role
    salt: bytes = b""

    @classmethod
    def plain(cls, token: str, role: Role) -> TokenRule:
        """Make a rule from the token itself."""
        return cls(hashlib.sha256(token.encode()).digest(), role)

    @classmethod
    def hashed(cls, text: str, role: Role) -> TokenRule:
        """Make a rule from ``sha256:<hex>`` or ``sha256:<salt>:<hex>``. Raises ``ValueError``."""
        match = _HASH.fullmatch(text)
        if match is None:
            raise ValueError("expected sha256:<64 hexadecimal digits>, or sha256:<salt>:<64 hexadecimal digits>")
        return cls(bytes.fromhex(match[2]), role, (match[1] or "").encode())

    def fits(self, token: str) -> bool:
        """Return whether this is the token, in constant time."""
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

    def fits(self, request: HttpRequest) -> bool:
        """Return whether the client's certificate, which TLS has verified, is one of these."""
        certificate = request.certificate
        if not certificate:
            return False
        if self.fingerprint and request.fingerprint != self.fingerprint.replace(":", "").lower():
            return False
        if self.common_name and not _any_fits(_common_names(certificate), self.common_name):
            return False
        alternatives = [str(value) for _, value in certificate.get("subjectAltName", ())]
        return not self.san or _any_fits(alternatives, self.san)


@dataclass(frozen=True, slots=True)
class Rejection(Response):
    """The answer to who may not come in. ``reason`` is what it is counted under: no word of it is the client's.

    ``kind`` groups them in the log; ``wrong_token`` is true where a token was shown that is none.
    """

    reason: str = ""
    kind: str = "handshake"
    wrong_token: bool = False

    def later(self, delay_s: float) -> Rejection:
        """Return the same, to be sent after ``delay_s``."""
        return replace(self, delay_s=delay_s)


@dataclass(frozen=True)
class Door:
    """Gives every client a role, or refuses it.

    ``default`` is the role of a client without credentials, ``None`` refuses it. ``hosts`` decides on the web pages
    whose scripts may connect, and on the names under which this server is reached; programs that are no browser send no
    origin, and may. ``max_clients`` bounds how many clients there are at a time.
    """

    tokens: Sequence[TokenRule] = ()
    certificates: Sequence[CertificateRule] = ()
    default: Role | None = EVERYTHING
    hosts: Hosts = Hosts()  # noqa: RUF009 - frozen
    globs: Globs = Globs()  # noqa: RUF009 - frozen
    max_clients: int | None = None

    @property
    def asks(self) -> bool:
        """Whether credentials make a difference here."""
        return bool(self.tokens or self.certificates)

    def role_of(self, request: HttpRequest) -> Role | Rejection:
        """Return the role of who sent this, or the answer that refuses it.

        That is 403 for the page that it is from or the name that it came by, and 401 without good credentials. The name
        does not matter to who shows a token: no page knows it that does not have it from its user.
        """
        strange = self._refuses_page(request)
        if strange is not None:
            return strange
        tokens = given_token(request) if self.tokens else []
        if tokens:
            found = [rule.role for rule in self.tokens for token in tokens if rule.fits(token)]
            return found[0] if found else _WRONG_TOKEN
        strange = self._refuses_host(request)
        if strange is not None:
            return strange
        for rule in self.certificates:
            if rule.fits(request):
                return rule.role
        return self.default or (_NOBODY if self.asks else _NO_CREDENTIALS)

    def refuses(self, request: HttpRequest) -> Rejection | None:
        """Return the answer to a request for what everybody may read, where the page or the name is a stranger's."""
        return self._refuses_page(request) or self._refuses_host(request)

    def _refuses_page(self, request: HttpRequest) -> Rejection | None:
        if self.hosts.knows_page(request):
            return None
        origin = request.headers.get("origin", "")[:SHOWN_TEXT_CHARACTERS]
        return refusal(
            403,
            f"web pages of {origin} may not connect; add {json.dumps(origin)} to gateway.auth.origins to let them "
            "(--origins of ropeway server)",
            reason="403 web pages of this origin may not connect",
            kind="origin",
        )

    def _refuses_host(self, request: HttpRequest) -> Rejection | None:
        if self.hosts.knows(request):
            return None
        host = request.headers.get("host", "")[:SHOWN_TEXT_CHARACTERS]
        return refusal(
            403,
            f"{host} is not known as a name of this server; add {json.dumps(host_of(host) or host)} to "
            "gateway.auth.hosts if it is one (--hosts of ropeway server)",
            reason="403 this is not known as a name of this server",
            kind="host",
        )


def given_token(request: HttpRequest) -> list[str]:
    """Return what a client gives as its token, by header, subprotocol or query, in this order; several readings of one
    are possible.
    """
    scheme, _, value = request.headers.get("authorization", "").partition(" ")
    if scheme.lower() == "bearer" and value.strip():
        return [value.strip()]
    for offered in request.subprotocols:
        if offered.startswith(BEARER) and len(offered) > len(BEARER):
            text = offered.removeprefix(BEARER)
            return list(dict.fromkeys((text, unquote(text))))
    query = request.query
    return [*query.get("token", ()), *query.get("access_token", ())][:1]


def subprotocol(request: HttpRequest, served: Sequence[str] = GATEWAY_SUBPROTOCOLS) -> str:
    """Return what a client that is let in is told: the first of those ``served``, never what carried its token.

    A browser takes no other than those it offered, so a page offers ``rosbridge`` beside its token.
    """
    offered = request.subprotocols
    return next((known for known in served if known in offered), "")


def unserved(request: HttpRequest, served: Sequence[str] = GATEWAY_SUBPROTOCOLS, *, plain: bool = True) -> str:
    """Return why a client cannot be served that insists on subprotocols of others; ``""`` where it does not.

    ``plain``: who offers none speaks rosbridge, and is served. A browser ends a connection for which none of those is
    chosen that it offered, and gives no reason.
    """
    others = [name for name in request.subprotocols if not name.startswith(BEARER)]
    browser = bool(request.headers.get("origin"))
    if subprotocol(request, served) or (plain and not (others or (browser and request.subprotocols))):
        return ""
    names = ", ".join(served)
    if not plain:
        return f"this port is for viewers that offer one of the subprotocols {names}"
    return (  # what was offered is not repeated: a token may be among it
        f"none of the subprotocols offered is served here, but {names} and none at all (which is rosbridge) are; in a "
        f"viewer, open a rosbridge connection; a page that offers {BEARER}<token> offers {PLAIN_SUBPROTOCOL} beside it"
    )


def refusal(status: int, text: str, *, reason: str = "", kind: str = "handshake", **headers: str) -> Rejection:
    """Return a refusal that says ``text``; it is counted under ``reason``, or the text itself."""
    made = reply(status, {"error": text}, **headers)
    return Rejection(status, made.body, made.headers, reason=reason or f"{status} {text}", kind=kind)


def _who_are_you(text: str, detail: str = "") -> Rejection:
    return refusal(401, text, WWW_Authenticate=f'Bearer realm="ropeway"{detail}')


_WRONG_TOKEN: Final = replace(_who_are_you("the token is not known here", ', error="invalid_token"'), wrong_token=True)
_NOBODY: Final = _who_are_you("a token or a certificate is needed")
_NO_CREDENTIALS: Final = _who_are_you("this server knows no credentials that would let anybody in")


def _common_names(certificate: Any) -> list[str]:
    return [value for part in certificate.get("subject", ()) for key, value in part if key == "commonName"]


def _any_fits(values: Iterable[str], *patterns: str) -> bool:
    return any(fnmatch.fnmatchcase(value, pattern) for value in values for pattern in patterns)
