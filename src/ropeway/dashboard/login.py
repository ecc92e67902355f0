"""The page on which one logs in: with the key of the dashboard, or with a token of a gateway."""

from __future__ import annotations

import asyncio
import math
from html import escape
from typing import TYPE_CHECKING, Final
from urllib.parse import parse_qs

from starlette.requests import Request
from starlette.responses import HTMLResponse, RedirectResponse, Response
from starlette.routing import Route

from ropeway.aio import timeout
from ropeway.dashboard.guard import LOGIN_PATH, cookie_of
from ropeway.dashboard.viewers import COOKIE, SESSION_S, Viewers
from ropeway.errors import ControlRefused
from ropeway.limits import CONTROL_REQUEST_S, DASHBOARD_LOGIN_BYTES
from ropeway.listener.lobby import network_of
from ropeway.listener.lockout import Lockout
from ropeway.listener.presence import ip_address

if TYPE_CHECKING:
    from ropeway.dashboard.watch_list import WatchList

__all__ = ["LOGOUT_PATH", "Login"]

LOGOUT_PATH: Final = "/logout"

_ANYBODY: Final = "anybody"
_COUNTS: Final = 2
"""How often a wrong token counts towards the lockout of all that are new."""

_PAGE: Final = """<!doctype html><html lang="en"><head><meta charset="utf-8"><title>Ropeway: log in</title>
<meta name="viewport" content="width=device-width, initial-scale=1"><style>
body {{font: 16px system-ui, sans-serif; background: #f1f5f9; color: #0f172a; display: grid;
place-items: center; min-height: 95vh; margin: 0 12px}} form {{background: #fff; padding: 24px; border-radius: 12px;
max-width: 360px; width: 100%; box-sizing: border-box; box-shadow: 0 1px 4px #0003}} input, button {{font: inherit;
width: 100%; box-sizing: border-box; padding: 10px; margin-top: 12px; border: 1px solid #94a3b8; border-radius: 8px}}
button {{background: #1d4ed8; color: #fff; border: 0}}
.wrong {{color: #b91c1c}} small {{color: #475569}}</style></head><body><form method="post" action="/login">
<h1>Ropeway</h1><label for="secret">Token of a gateway, or the key of this dashboard</label>
<input id="secret" name="secret" type="password" autocomplete="current-password" autofocus required>
<button>Log in</button><p class="wrong">{wrong}</p>
<small>The key is in the address that <code>ropeway dashboard</code> printed.</small></form></body></html>"""


class Login:
    """Logs browsers in and out. Wrong secrets are answered later and later, and then not at all for a while."""

    def __init__(self, viewers: Viewers, fleet: WatchList, *, secure: bool = False) -> None:
        self._viewers, self._fleet, self._secure = viewers, fleet, secure
        self.lockout = Lockout()

    def routes(self) -> list[Route]:
        """Return the routes for the application."""
        return [
            Route(LOGIN_PATH, self._login, methods=["GET", "POST"]),
            Route(LOGOUT_PATH, self._logout, methods=["POST"]),
        ]

    async def _login(self, request: Request) -> Response:
        if request.method == "GET":
            key = request.query_params.get("key", "")
            return await self._try(request, key) if key else _page()
        try:
            async with timeout(CONTROL_REQUEST_S):
                body = await _body(request)
        except TimeoutError:
            return _page("The request did not come in time.", 408)
        secret = parse_qs(body.decode("utf-8", "replace")).get("secret", [""])[0]
        return await self._try(request, secret.strip())

    async def _try(self, request: Request, secret: str) -> Response:
        sender = network_of(ip_address("" if request.client is None else request.client.host))
        locked_s = self.lockout.locked_s(sender)
        if locked_s > 0:
            return _page(f"Too many wrong tokens came from this address; try again in {math.ceil(locked_s)} s.", 429)
        try:
            known = self._viewers.is_key(secret) or await self._is_token(secret)
        except ControlRefused as error:  # it may have been a guess at the key
            await asyncio.sleep(self.lockout.wrong(sender))
            return _page(f"{error}.", error.status)
        if not known:
            await asyncio.sleep(self.lockout.wrong(sender))
            return _page("No gateway knows this token, and it is not the key.", 401)
        session = self._viewers.begin(None if self._viewers.is_key(secret) else secret)
        answer = RedirectResponse("/", 303)
        answer.set_cookie(COOKIE, session, max_age=round(SESSION_S), httponly=True, samesite="lax", secure=self._secure)
        return answer

    async def _is_token(self, secret: str) -> bool:
        """Return whether a gateway takes a secret as a token. Raises ``ControlRefused`` where none can be asked now.

        To a gateway all guesses come from this machine, and ten would lock out everybody here. So half as many are
        passed on, whoever makes them, before tokens that are new have to wait.
        """
        locked_s = self.lockout.locked_s(_ANYBODY)
        if locked_s > 0:
            text = (
                f"too many wrong tokens were tried here; try again in {math.ceil(locked_s)} s, or log in with the key"
            )
            raise ControlRefused(429, text)
        known = bool(secret) and await self._fleet.knows(secret)
        if not known:
            for _ in range(_COUNTS):
                self.lockout.wrong(_ANYBODY)
        return known

    async def _logout(self, request: Request) -> Response:
        self._viewers.end(cookie_of(request.headers))
        answer = RedirectResponse(LOGIN_PATH, 303)
        answer.delete_cookie(COOKIE)
        return answer


async def _body(request: Request) -> bytes:
    body = b""
    async for part in request.stream():
        body += part
        if len(body) > DASHBOARD_LOGIN_BYTES:
            return b""
    return body


def _page(wrong: str = "", status: int = 200) -> Response:
    return HTMLResponse(_PAGE.format(wrong=escape(wrong)), status)
