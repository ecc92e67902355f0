"""The viewers of the dashboard: logins with its key or with a token of a gateway, and the sessions of browsers."""

from __future__ import annotations

import hmac
import secrets
import time
from collections import OrderedDict
from collections.abc import Callable
from dataclasses import dataclass
from typing import Final

from ropeway.limits import DASHBOARD_SESSIONS

__all__ = ["COOKIE", "Viewer", "Viewers"]

COOKIE: Final = "ropeway_dashboard"
SESSION_S: Final = 12 * 3600.0
_BYTES: Final = 32


@dataclass(eq=False)
class Viewer:
    """A browser that was let in. ``token`` is shown to gateways; ``None`` is for who has the key of the dashboard."""

    token: str | None
    until_s: float
    active: bool = True


class Viewers:
    """The sessions, by the secret in the browser's cookie; the oldest goes where there are too many.

    ``open`` lets everybody in, as who has the key.
    """

    def __init__(self, key: str = "", *, open: bool = False, clock: Callable[[], float] = time.monotonic) -> None:
        self.key = key or secrets.token_urlsafe(_BYTES)
        self._clock = clock
        self._everybody = Viewer(None, float("inf")) if open else None
        self._sessions: OrderedDict[str, Viewer] = OrderedDict()

    def is_key(self, secret: str) -> bool:
        """Return whether a secret is the key of the dashboard, in a time that tells nothing."""
        return hmac.compare_digest(secret.encode(), self.key.encode())

    def begin(self, token: str | None) -> str:
        """Begin a session; return the secret for the cookie."""
        secret = secrets.token_urlsafe(_BYTES)
        self._sessions[secret] = Viewer(token, self._clock() + SESSION_S)
        while len(self._sessions) > DASHBOARD_SESSIONS:
            _, oldest = self._sessions.popitem(last=False)
            oldest.active = False
        return secret

    def find(self, secret: str) -> Viewer | None:
        """Return who has a secret, ``None`` for nobody."""
        if self._everybody is not None:
            return self._everybody
        viewer = self._sessions.get(secret)
        if viewer is not None and self._clock() > viewer.until_s:
            self.end(secret)
            return None
        return viewer

    def end(self, secret: str) -> None:
        """End a session; its pages do no more."""
        viewer = self._sessions.pop(secret, None)
        if viewer is not None:
            viewer.active = False
