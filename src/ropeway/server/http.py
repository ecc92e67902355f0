"""What the server answers to plain HTTP on its port: who it is, whether it lives, whether it is ready."""

from __future__ import annotations

from collections.abc import Callable, Sequence
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
    which web pages may read the answers.
    """

    def __init__(self, reasons: Callable[[], Sequence[str]], knows_origin: Callable[[str], bool]) -> None:
        self._reasons, self._knows_origin = reasons, knows_origin

    def __call__(self, request: Request) -> Response:
        """The answer."""
        status, value = self._page(request.path)
        headers: dict[str, str] = {}
        if status != 404 and request.method not in ("GET", "HEAD"):
            status, value = 405, {"error": f"{request.method} is not known here"}
            headers["Allow"] = _METHODS
        origin = request.headers.get("origin", "")
        if origin and self._knows_origin(origin):
            headers |= {"Access_Control_Allow_Origin": origin, "Vary": "Origin"}
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
