"""Says what serves pages to clients that were let in, on the port of a listener."""

from __future__ import annotations

import asyncio
from collections.abc import Callable
from typing import Final, Protocol

from ropeway.listener.authorization import Access, Role
from ropeway.listener.http import HttpRequest, Response

__all__ = ["ClientPages", "preflight"]

_HEADERS: Final = "authorization, content-type, last-event-id"
_KEPT_S: Final = 600  # browsers ask again after ten minutes, some after two hours whatever is said


def preflight(request: HttpRequest, methods: tuple[str, ...]) -> Response | None:
    """Return the answer to a browser that asks whether the script of a page may send a request; ``None`` for others.

    Browsers ask without the credentials of the request that is to come.
    """
    origin = request.headers.get("origin")
    if request.method != "OPTIONS" or not origin or "access-control-request-method" not in request.headers:
        return None
    headers = {
        "Access-Control-Allow-Origin": origin,
        "Access-Control-Allow-Methods": ", ".join(methods),
        "Access-Control-Allow-Headers": _HEADERS,
        "Access-Control-Max-Age": str(_KEPT_S),
        "Vary": "Origin",
    }
    return Response(204, b"", headers)


class ClientPages(Protocol):
    """Serves the pages below some paths."""

    cross_origin_methods: tuple[str, ...]
    """The methods that scripts of web pages of other origins may use, as far as these pages are let in."""

    def knows(self, path: str) -> bool:
        """Return whether ``path`` is one of its paths."""
        ...

    def __call__(self, request: HttpRequest, access: Access) -> Response | asyncio.Protocol:
        """Return the answer to a client with these rights, or the protocol that goes on with the connection."""
        ...

    def recheck(self, keeps: Callable[[HttpRequest, Role], bool]) -> None:
        """End what is under way for clients that would no longer come in with the same role."""
        ...
