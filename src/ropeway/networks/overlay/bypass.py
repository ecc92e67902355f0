"""A bypass for small messages beside the links that carry big ones.

Zenoh has one connection to each router and gateway. A command on it waits for every packet of an image that was lost
before it. So a gateway that sends both over a distance opens a second session: a client of one of its routers, which
takes part in no routing and accepts nobody. Packets with small messages go over both, and whichever comes first is
delivered; the other is a replay. So nothing depends on the bypass: where there is none, or where it is slower, all
comes by the links, in the same order. A packet is sealed once, and a reader opens it the same way, wherever it comes
from.

A copy is put under a key of the gateway that is to have it, with the name and the publisher beside it. Gateways that
know nothing of copies do not read that key.
"""

from __future__ import annotations

import asyncio
import contextlib
import logging
from collections.abc import Callable, Collection
from typing import TYPE_CHECKING, Final

from ropeway import aio
from ropeway.errors import GraphUnavailable
from ropeway.limits import OVERLAY_COPY_BYTES
from ropeway.networks.overlay.data_plane import DataPlane, Handle
from ropeway.networks.overlay.fabric import Fabric
from ropeway.networks.overlay.zenoh_config import gateway_id
from ropeway.tasks import Supervised, end

if TYPE_CHECKING:
    import zenoh

__all__ = ["Bypass", "copy_key"]

log = logging.getLogger("ropeway.overlay")

_IDLE_S: Final = 60.0  # without a copy: the session is closed
_LOOK_S: Final = 5.0
_AGAIN_S: Final = 30.0  # after no router could be reached: the links say so already
_NAME_BYTES, _PUBLISHER_BYTES = 32, 16


def copy_key(gateway: bytes) -> str:
    """Return where a gateway takes copies."""
    return f"rw/x/{gateway.hex()}"


class Bypass:
    """The second session of a gateway, while it is wanted.

    ``config`` makes its configuration with an id; ``take(name, publisher, packet)`` is given each copy that comes, in
    Zenoh's thread.
    """

    def __init__(
        self,
        links: DataPlane,
        config: Callable[[bytes], zenoh.Config],
        routers: Collection[str],
        take: Callable[[bytes, bytes, bytes], None],
    ) -> None:
        self._links, self._config, self._routers, self._take = links, config, routers, take
        self._fabric: Fabric | None = None
        self._wanted, self._stale = asyncio.Event(), asyncio.Event()
        self._end: Handle | None = None
        self._keeping = Supervised(self._keep, "overlay bypass")

    def open(self) -> None:
        """Take copies from now on, and send some once they are wanted."""
        self._end = self._links.subscribe(copy_key(self._links.gateway), self._came)
        if self._routers:
            self._keeping.start()

    async def close(self) -> None:
        """Take and send no more."""
        if self._end is not None:
            self._end()
            self._end = None
        await end(self._keeping)

    def _came(self, _: str, payload: zenoh.ZBytes, about: zenoh.ZBytes | None, __: int) -> None:
        """Take a copy; runs in Zenoh's thread."""
        raw = b"" if about is None else bytes(about)
        if len(raw) == _NAME_BYTES + _PUBLISHER_BYTES and len(payload) <= OVERLAY_COPY_BYTES:
            self._take(raw[:_NAME_BYTES], raw[_NAME_BYTES:], bytes(payload))

    # ── the session ────────────────────────────────────────────────────────────────────────────────────────────

    def want(self) -> None:
        """See that there is a second session, soon and for a while."""
        self._wanted.set()

    def renew(self) -> None:
        """Make the session anew, as other members are denied now."""
        self._stale.set()

    async def _keep(self) -> None:
        while True:
            await self._wanted.wait()
            try:
                await self._run()
            except GraphUnavailable as error:
                log.debug("overlay: no second session for small messages: %s", error)
                await asyncio.sleep(_AGAIN_S)

    async def _run(self) -> None:
        """Have a session until it is not wanted any more, is to be made anew, or has lost its router."""
        self._stale.clear()
        id = gateway_id()
        fabric = Fabric(self._config(id), id, routers=self._routers)
        try:
            await fabric.open()
            self._fabric = fabric
            log.debug("overlay: small messages go by a second session, too")
            loop = asyncio.get_running_loop()
            wanted_s = loop.time()
            while loop.time() - wanted_s < _IDLE_S:
                self._wanted.clear()
                with contextlib.suppress(TimeoutError):
                    async with aio.timeout(_LOOK_S):
                        await self._stale.wait()
                    return
                if self._wanted.is_set():
                    wanted_s = loop.time()
                if not fabric.connection:  # looked for only now: a new link is told of a moment later
                    return
        finally:
            self._fabric = None
            await fabric.close()

    # ── copies ─────────────────────────────────────────────────────────────────────────────────────────────────

    @property
    def connection(self) -> int:
        """The number of the connection that it has, 0 where it has none."""
        fabric = self._fabric
        return 0 if fabric is None else fabric.connection

    def put(self, lane: int, about: bytes, gateway: bytes, packet: bytes) -> None:
        """Send a gateway a copy, of the name and publisher in ``about``; from any thread."""
        fabric = self._fabric
        if fabric is not None:
            fabric.offer(lane, copy_key(gateway), packet, about)
