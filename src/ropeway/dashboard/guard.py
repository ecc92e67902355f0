"""Stands in front of the pages: refuses strangers' names and pages, asks who it is, and keeps browsers strict."""

from __future__ import annotations

from collections.abc import Mapping
from http.cookies import CookieError, SimpleCookie
from typing import Any, Final, cast

from starlette.responses import PlainTextResponse, RedirectResponse
from starlette.types import ASGIApp, Message, Receive, Scope, Send

from ropeway.dashboard.viewers import COOKIE, Viewer, Viewers
from ropeway.listener.hosts import Hosts
from ropeway.listener.http import HttpRequest

__all__ = ["LOGIN_PATH", "Guard", "cookie_of", "viewer_of"]

LOGIN_PATH: Final = "/login"

_VIEWER: Final = "ropeway.viewer"
_HEADERS: Final = (
    (b"content-security-policy", b"frame-ancestors 'none'; object-src 'none'; base-uri 'self'; form-action 'self'"),
    (b"x-content-type-options", b"nosniff"),
    (b"referrer-policy", b"same-origin"),  # a key may stand in the address; "no-referrer" would hide our own Origin
    (b"x-frame-options", b"DENY"),
)
_POLICY_VIOLATION: Final = 1008  # of RFC 6455


class Guard:
    """An ASGI application that lets only those through to another whom ``viewers`` knows."""

    def __init__(self, app: ASGIApp, viewers: Viewers, hosts: Hosts) -> None:
        self._app, self._viewers, self._hosts = app, viewers, hosts

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Answer a request, or have it answered."""
        if scope["type"] not in ("http", "websocket"):
            await self._app(scope, receive, send)
            return
        headers = _headers(scope)
        refusal = self._refusal(scope, headers)
        if refusal:
            await _refuse(scope, receive, send, refusal)
            return
        viewer = self._viewers.find(cookie_of(headers))
        if viewer is None and scope["path"] != LOGIN_PATH:
            await _ask_who(scope, receive, send, headers)
            return
        scope[_VIEWER] = viewer

        async def stricter(message: Message) -> None:
            if message["type"] == "http.response.start":
                message = {**message, "headers": [*message["headers"], *_HEADERS]}
            await send(message)

        await self._app(scope, receive, stricter)

    def _refusal(self, scope: Scope, headers: Mapping[str, str]) -> str:
        """Return why a request is refused whoever sends it, ``""`` where it is not."""
        local = (scope.get("server") or ("", 0))[0]
        request = HttpRequest("GET", "/", "HTTP/1.1", headers, local=local)
        if not self._hosts.knows(request):
            return "the dashboard is not known by this name; open it by its address, or name it with --host-name"
        return "" if self._hosts.knows_page(request) else "pages of other sites may not use the dashboard"


def viewer_of(scope: Scope) -> Viewer:
    """Return who sent a request that was let through."""
    return cast("Viewer", scope[_VIEWER])


def cookie_of(headers: Mapping[str, str]) -> str:
    """Return the secret of the session that a browser shows, ``""`` for none."""
    try:
        found = SimpleCookie(headers.get("cookie", "")).get(COOKIE)
    except CookieError:
        return ""
    return "" if found is None else found.value


def _headers(scope: Scope) -> dict[str, str]:
    return {name.decode("latin-1"): value.decode("latin-1") for name, value in scope["headers"]}


async def _refuse(scope: Scope, receive: Receive, send: Send, why: str) -> None:
    if scope["type"] == "websocket":
        await send({"type": "websocket.close", "code": _POLICY_VIOLATION, "reason": why[:100]})
        return
    await PlainTextResponse(why + "\n", 403)(scope, receive, send)


async def _ask_who(scope: Scope, receive: Receive, send: Send, headers: Mapping[str, str]) -> None:
    if scope["type"] == "websocket":
        await _refuse(scope, receive, send, "log in first")
        return
    page = "text/html" in headers.get("accept", "") and scope["method"] == "GET"
    answer: Any = RedirectResponse(LOGIN_PATH, 303) if page else PlainTextResponse("log in first\n", 401)
    await answer(scope, receive, send)
