"""Answers plain HTTP on the server's port: what it is, whether it lives, whether it is ready."""

from __future__ import annotations

import asyncio
from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import Any, Final

from ropeway import __version__
from ropeway.listener.authentication import Rejection
from ropeway.listener.http import HttpRequest, Response, reply

__all__ = ["PROTOCOL", "Pages"]

PROTOCOL: Final = {"major": 2, "minor": 1, "patch": 0}
"""The version of the rosbridge protocol that is spoken here."""

_METHODS: Final = "GET, HEAD"


class Pages:
    """Answers ``/``, ``/healthz`` and ``/readyz``; called with a request.

    ``reasons`` tells why the server is not ready, in sentences, and is empty once it is. ``refuses`` gives the answer
    to web pages of strangers. ``more`` answers other paths, or gives ``None`` for those it has not.
    """

    def __init__(
        self,
        reasons: Callable[[], Sequence[str]],
        refuses: Callable[[HttpRequest], Response | None],
        more: Callable[[HttpRequest], Response | asyncio.Protocol | None] = lambda request: None,
    ) -> None:
        self._reasons, self._refuses, self._more = reasons, refuses, more

    def __call__(self, request: HttpRequest) -> Response | asyncio.Protocol:
        """Return the answer to a request."""
        found = self._more(request)
        if found is None:
            found = self._refuses(request) or self._own(request)
        if not isinstance(found, Response) or isinstance(found, Rejection):
            return found
        return replace(found, headers={**found.headers, **_readable(request)})

    def _own(self, request: HttpRequest) -> Response:
        status, value = self._page(request.path)
        headers: dict[str, str] = {}
        if status != 404 and request.method not in ("GET", "HEAD"):
            status, value = 405, {"error": f"{request.method} is not known here"}
            headers["Allow"] = _METHODS
        return reply(status, value, **headers)

    def _page(self, path: str) -> tuple[int, dict[str, Any]]:
        if path == "/":
            return 200, {"protocol": PROTOCOL, "server": f"ropeway {__version__}"}
        if path == "/healthz":
            return 200, {"status": "ok"}
        if path == "/readyz":
            reasons = list(self._reasons())
            return (503, {"status": "not ready", "reasons": reasons}) if reasons else (200, {"status": "ready"})
        return 404, {"error": f"there is nothing at {path}"}


def _readable(request: HttpRequest) -> dict[str, str]:
    """Return what lets the web page that sent this read the answer; pages that may not are refused before."""
    origin = request.headers.get("origin", "")
    return {"Access-Control-Allow-Origin": origin, "Vary": "Origin"} if origin else {}
