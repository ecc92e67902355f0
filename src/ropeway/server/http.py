"""What the server answers to plain HTTP on its port: who it is, whether it lives, whether it is ready."""

from __future__ import annotations

import asyncio
from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import Any, Final

from ropeway import __version__
from ropeway.link.http import Request, Response, reply

__all__ = ["PROTOCOL", "Pages"]

PROTOCOL: Final = {"major": 2, "minor": 1, "patch": 0}
"""The version of the rosbridge protocol that is spoken here."""

_METHODS: Final = "GET, HEAD"


class Pages:
    """Answers ``/``, ``/healthz`` and ``/readyz``; called with a request.

    ``reasons`` tells why the server is not ready, in sentences, and is empty once it is. ``knows_origin`` decides
    which web pages may read the answers. ``more`` answers other paths, or gives ``None`` for those it has not.
    """

    def __init__(
        self,
        reasons: Callable[[], Sequence[str]],
        knows_origin: Callable[[str], bool],
        more: Callable[[Request], Response | asyncio.Protocol | None] = lambda request: None,
    ) -> None:
        self._reasons, self._knows_origin, self._more = reasons, knows_origin, more

    def __call__(self, request: Request) -> Response | asyncio.Protocol:
        """The answer."""
        found = self._more(request)
        if isinstance(found, Response):
            return replace(found, headers={**found.headers, **_allowed(request, self._knows_origin)})
        if found is not None:
            return found
        status, value = self._page(request.path)
        headers: dict[str, str] = {}
        if status != 404 and request.method not in ("GET", "HEAD"):
            status, value = 405, {"error": f"{request.method} is not known here"}
            headers["Allow"] = _METHODS
        made = reply(status, value, **headers)
        return replace(made, headers={**made.headers, **_allowed(request, self._knows_origin)})

    def _page(self, path: str) -> tuple[int, dict[str, Any]]:
        if path == "/":
            return 200, {"protocol": PROTOCOL, "server": f"ropeway {__version__}"}
        if path == "/healthz":
            return 200, {"status": "ok"}
        if path == "/readyz":
            reasons = list(self._reasons())
            return (503, {"status": "not ready", "reasons": reasons}) if reasons else (200, {"status": "ready"})
        return 404, {"error": f"there is nothing at {path}"}


def _allowed(request: Request, knows_origin: Callable[[str], bool]) -> dict[str, str]:
    """What lets a web page of another origin read the answer."""
    origin = request.headers.get("origin", "")
    if not origin or not knows_origin(origin):
        return {}
    return {"Access-Control-Allow-Origin": origin, "Vary": "Origin"}
