"""The little HTTP that a WebSocket port needs: the head of a request, and small answers."""

from __future__ import annotations

import json
import re
from collections.abc import Mapping
from dataclasses import dataclass, field
from http import HTTPStatus
from typing import Any, Final
from urllib.parse import parse_qs, urlsplit

from ropeway.errors import InvalidFrame
from ropeway.limits import HTTP_HEAD_BYTES

__all__ = ["MAX_HEAD_BYTES", "HttpRequest", "Response", "parse_head", "reply", "without_token"]

MAX_HEAD_BYTES: Final = HTTP_HEAD_BYTES
"""A longer head of a request is refused with 431."""

_SECRET: Final = re.compile(r"([?&](?:token|access_token)=)[^&#\s]*", re.IGNORECASE)
_MAX_HEADERS: Final = 128
_TOKEN: Final = re.compile(rb"[!#$%&'*+.^_`|~0-9A-Za-z-]+")
_VALUE: Final = re.compile(rb"[\t\x20-\x7e\x80-\xff]*")
_TARGET: Final = re.compile(rb"[\x21-\x7e]+")
_ONCE: Final = frozenset(("host", "authorization", "origin", "upgrade", "sec-websocket-key", "content-length"))


@dataclass(frozen=True, slots=True)
class HttpRequest:
    """The head of a request, and who sent it.

    The names in ``headers`` are in lower case; values of a repeated one are joined with a comma. ``peer`` is the
    address and port of the client, ``local`` the address of this machine that it connected to. ``certificate`` is what
    TLS verified, as ``ssl.SSLSocket.getpeercert`` gives it, ``fingerprint`` its SHA-256 in hexadecimal digits.
    ``head`` is what was read, for a protocol that takes the connection over.
    """

    method: str
    target: str
    version: str
    headers: Mapping[str, str]
    peer: str = ""
    local: str = ""
    secure: bool = False
    certificate: Mapping[str, Any] | None = field(default=None, repr=False)
    fingerprint: str = ""
    head: bytes = field(default=b"", repr=False)

    @property
    def path(self) -> str:
        """The path of the target, without the query."""
        return urlsplit(self.target).path or "/"

    @property
    def query(self) -> Mapping[str, list[str]]:
        """The parameters after the question mark."""
        return parse_qs(urlsplit(self.target).query)

    @property
    def subprotocols(self) -> tuple[str, ...]:
        """The WebSocket subprotocols that the client offers, in its order."""
        offered = self.headers.get("sec-websocket-protocol", "").split(",")
        return tuple(part.strip() for part in offered if part.strip())

    @property
    def upgrades(self) -> bool:
        """Whether the request asks to become a WebSocket."""
        return "websocket" in [part.strip().lower() for part in self.headers.get("upgrade", "").split(",")]

    @property
    def from_program(self) -> bool:
        """Whether no browser sends this: a request for a WebSocket that says no page."""
        return self.upgrades and "sec-websocket-key" in self.headers and "origin" not in self.headers


@dataclass(frozen=True, slots=True)
class Response:
    """An answer, which is sent after ``delay_s``. The connection is closed after it."""

    status: int
    body: bytes = b""
    headers: Mapping[str, str] = field(default_factory=dict)
    delay_s: float = 0.0

    def encode(self, *, body: bool = True) -> bytes:
        """Return the bytes to send; without ``body``, those that answer a ``HEAD``."""
        lines = [
            f"HTTP/1.1 {self.status} {HTTPStatus(self.status).phrase}",
            *(f"{name}: {value}" for name, value in self.headers.items()),
            f"Content-Length: {len(self.body)}",
            "Cache-Control: no-store",
            "X-Content-Type-Options: nosniff",
            "Connection: close",
        ]
        head = "\r\n".join([*lines, "", ""]).encode("latin-1")
        return head + self.body if body else head


def reply(status: int, value: Any, **headers: str) -> Response:
    """Make an answer in JSON; the names of ``headers`` are written with ``_`` for ``-``."""
    named = {name.replace("_", "-"): text for name, text in headers.items()}
    return Response(status, json.dumps(value).encode() + b"\n", {"Content-Type": "application/json", **named})


def without_token(url: str) -> str:
    """Return an address as it may be shown: a token in its query is replaced by dots."""
    return _SECRET.sub(r"\1...", url)


def parse_head(head: bytes) -> HttpRequest:
    """Parse the head of a request, including the empty line that ends it. Raises ``InvalidFrame``."""
    first, *lines = head.removesuffix(b"\r\n\r\n").split(b"\r\n")
    parts = first.split(b" ")
    if len(parts) != 3 or not _TOKEN.fullmatch(parts[0]) or not _TARGET.fullmatch(parts[1]):
        raise InvalidFrame("the first line is not an HTTP request")
    if parts[2] not in (b"HTTP/1.1", b"HTTP/1.0"):
        raise InvalidFrame("only HTTP/1.1 and HTTP/1.0 are spoken here")
    if len(lines) > _MAX_HEADERS:
        raise InvalidFrame(f"more than {_MAX_HEADERS} header lines")
    headers: dict[str, str] = {}
    for line in lines:
        name, colon, raw = line.partition(b":")
        value = raw.strip(b" \t")
        if not colon or not _TOKEN.fullmatch(name) or not _VALUE.fullmatch(value):
            raise InvalidFrame("a header line is malformed")
        key, text = name.decode("ascii").lower(), value.decode("latin-1")
        if key in headers:
            if key in _ONCE:
                raise InvalidFrame(f"the header {key} stands twice")
            text = f"{headers[key]}, {text}"
        headers[key] = text
    target = parts[1].decode("ascii")
    try:
        urlsplit(target)
    except ValueError:
        raise InvalidFrame("the target is not an address") from None
    return HttpRequest(parts[0].decode("ascii"), target, parts[2].decode("ascii"), headers, head=head)
