"""Defines what carries the overlay's data: a Zenoh session (``fabric``), or one by each link (``linked_sessions``)."""

from __future__ import annotations

import asyncio
from collections.abc import Callable, Collection
from typing import TYPE_CHECKING, Any, Final, Protocol, TypeVar

from ropeway.limits import OVERLAY_NOTE_BYTES, OVERLAY_ROUTED_BYTES, OVERLAY_WAITING_NOTES_BYTES
from ropeway.networks.overlay.asked import Asked

if TYPE_CHECKING:
    import zenoh

__all__ = ["CRL_KEY", "DataPlane", "Handle", "Take", "probe_key"]

CRL_KEY: Final = "rw/crl"
"""Where the fleet's revocation list is told and asked for."""

T = TypeVar("T")

Handle = Callable[[], None]
"""Called to end what was declared; may be called again."""

Take = Callable[[str, "zenoh.ZBytes", "zenoh.ZBytes | None", int], None]
"""Takes a key, what was put there, the mark beside it, and by which of our ways it came; in Zenoh's thread."""


def probe_key(id: str) -> str:
    """Return where a router or gateway with this Zenoh id answers probes."""
    return f"rw/p/{id}"


class DataPlane(Protocol):
    """Carries data, notes and queries between gateways. ``gateway`` is our id in the overlay."""

    @property
    def gateway(self) -> bytes:
        """Return our id, 16 bytes."""

    @property
    def connection(self) -> int:
        """A number that is another with each link that is made, 0 while there is none."""

    async def open(self) -> None:
        """Start; it goes on trying to reach its routers. Raises ``GraphUnavailable``."""

    async def close(self) -> None:
        """End; nothing is delivered after this returns."""

    def subscribe(self, key: str, callback: Take) -> Handle:
        """Call ``callback`` in Zenoh's thread for what is put under ``key``."""

    def hear(
        self, key: str, callback: Callable[[str, bytes], None], *, limit_bytes: int = OVERLAY_NOTE_BYTES
    ) -> Handle:
        """Subscribe with a callback on the loop, for payloads of ``limit_bytes`` at most."""

    def watch(self, key: str, callback: Callable[[str, bool], None]) -> Handle:
        """Call ``callback(key, alive)`` on the loop for tokens that come and go, and are there now."""

    def serve(
        self, key: str, callback: Callable[[Asked], None], *, limit_bytes: int = OVERLAY_WAITING_NOTES_BYTES
    ) -> Handle:
        """Call ``callback`` on the loop for each query of ``key``; ``limit_bytes`` of them may wait for it."""

    def token(self, key: str) -> Handle:
        """Show that we are alive under ``key``."""

    def tell(self, key: str, payload: bytes, *, copies: bool = False) -> None:
        """Put a small note; lost where the link is congested, and while the session is made anew.

        ``copies``: it may come more than once.
        """

    def short(self, key: str) -> zenoh.KeyExpr:
        """Return a key that goes over each link once, and as a number from then on; see ``forget``."""

    def forget(self, key: zenoh.KeyExpr) -> None:
        """Take a short key back."""

    def put(
        self,
        lane: int,
        key: str | zenoh.KeyExpr,
        payload: bytes,
        mark: bytes | None = None,
        *,
        copies: bool = False,
    ) -> None:
        """Put data, with a mark beside it; waits while the link is congested, so call it in the lane's thread.

        ``copies``: who reads it tells copies from replays.
        """

    def in_lane(self, lane: int, work: Callable[[], T]) -> asyncio.Future[T]:
        """Run ``work`` in the thread of a lane, in order."""

    async def ask(
        self,
        key: str,
        payload: bytes,
        timeout_s: float,
        *,
        lane: int = 1,
        limit_bytes: int = OVERLAY_ROUTED_BYTES,
        first: bool = False,
    ) -> list[bytes]:
        """Return every answer to a query, once all who can answer have; fewer, or none, after ``timeout_s``.

        ``first``: one answer is enough.
        """

    async def linked(self, timeout_s: float) -> bool:
        """Wait until a router or another gateway is linked with us; false when the time is over."""

    def linked_with(self, names: Collection[str]) -> bool:
        """Return whether there is a link with one of these names in its certificate."""

    def links(self) -> set[str]:
        """Return the routers and gateways that we are linked with now, by Zenoh id."""

    def status(self) -> dict[str, Any]:
        """Return the state of the links by interface as JSON; empty where there is one way alone."""
