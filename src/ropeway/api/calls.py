"""Defines what services and actions of programs share: a user of the name, and a provider."""

from __future__ import annotations

import asyncio
from typing import TYPE_CHECKING, Final, Generic, TypeVar

from ropeway.api.part import Part
from ropeway.errors import NotServed
from ropeway.graph.calls import DEFAULT_TIMEOUT_S

if TYPE_CHECKING:
    from ropeway.hub.actions import ViewActionClient, ViewActionServer
    from ropeway.hub.calls import ViewClient, ViewService
    from ropeway.hub.hub import View

__all__ = ["OfferPart", "UserPart"]

_LEAST_S: Final = (
    0.001  # what is left of a time limit that is over, so that the error tells of the step that was not made
)

_User = TypeVar("_User", bound="ViewClient | ViewActionClient")
_Server = TypeVar("_Server", bound="ViewService | ViewActionServer")


class UserPart(Part, Generic[_User]):
    """A service or an action that a program uses. ``kind`` is which of both, ``name`` its name on the graph."""

    def __init__(self, view: View, inner: _User, kind: str, name: str) -> None:
        super().__init__(view)
        self.type = inner.type
        self._inner = inner
        self._kind, self._name = kind, name

    @property
    def available(self) -> bool | None:
        """Return whether somebody serves it now, ``None`` where the network cannot tell before it is used."""
        return self._inner.available

    async def wait_available(self, *, timeout_s: float = DEFAULT_TIMEOUT_S) -> None:
        """Wait until somebody serves it; return at once where the network cannot tell. Raises ``NotServed``."""
        if self.available is False and not await self._inner.wait_available(timeout_s):
            raise NotServed(self._name, self._kind)

    async def _found(self, timeout_s: float) -> float:
        """Wait until somebody serves it; return the seconds that are left. Raises ``NotServed``."""
        loop = asyncio.get_running_loop()
        deadline = loop.time() + timeout_s
        await self.wait_available(timeout_s=timeout_s)
        return max(deadline - loop.time(), _LEAST_S)


class OfferPart(Part, Generic[_Server]):
    """A service or an action that a program offers."""

    def __init__(self, view: View) -> None:
        super().__init__(view)
        self._inner: _Server | None = None

    def attach(self, inner: _Server) -> None:
        """Follow what the graph made of it."""
        self._inner = inner

    @property
    def _server(self) -> _Server:
        assert self._inner is not None
        return self._inner

    @property
    def type(self) -> str:
        """Return the full name of its type."""
        return self._server.type

    @property
    def taken_by(self) -> str:
        """Return who else serves the name, until which leaves this one waits; ``""`` while it serves."""
        return self._server.taken_by
