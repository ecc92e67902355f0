"""Maintains the links of one gateway: closed for revoked members, made anew if Zenoh fails; says why if there are
none.
"""

from __future__ import annotations

import asyncio
import contextlib
import logging
from collections.abc import Callable, Sequence
from typing import TYPE_CHECKING, Final

from ropeway.errors import GraphUnavailable
from ropeway.limits import OVERLAY_MESSAGE_BYTES, OVERLAY_ROUTED_BYTES
from ropeway.networks.overlay.crypto.identity import Identity
from ropeway.networks.overlay.crypto.trust import Trust
from ropeway.networks.overlay.data_plane import DataPlane, Handle
from ropeway.networks.overlay.fabric import Fabric
from ropeway.networks.overlay.linked_sessions import LinkedSessions
from ropeway.networks.overlay.router_probe import unreachable
from ropeway.networks.overlay.zenoh_config import by_interface, client_config, gateway_config, gateway_id
from ropeway.tasks import Supervised, end

if TYPE_CHECKING:
    import zenoh

__all__ = ["Links"]

log = logging.getLogger("ropeway.overlay")

_LOOK_S: Final = 5.0
_LINK_S: Final = 5.0  # after which it is said that there is no link
_FIRST_LINK_S: Final = 1.0  # without a router there is nobody to learn from, and the gateway starts all the same
_MUTE: Final = 2  # requests in a row that not even we answered: Zenoh has failed
_DESERTED: Final = 2  # looks in a row at which a link made anew has brought nobody back
_SOON_S: Final = 30.0  # after a link was made again: who leaves later has left
_MEND_S: Final = 15.0  # between two sessions that are made anew because Zenoh failed; doubles
_MEND_LIMIT_S: Final = 3600.0


class Links:
    """The sessions of a gateway, as ``trust`` has it. ``unlinked`` says why there is no link, if there is none.

    There is one for each of ``interfaces`` if ``links`` says how they are used at once, ``best`` or ``duplicate``;
    otherwise there is one for all, and each interface comes into use when the one before has failed.
    """

    def __init__(
        self,
        identity: Identity,
        trust: Trust,
        gateway: bytes,
        routers: Sequence[str],
        listen: Sequence[str],
        max_message_bytes: int,
        interfaces: Sequence[str] = (),
        *,
        links: str | None = None,
        link_s: float = _LINK_S,
    ) -> None:
        self.unlinked = ""
        self.on_doubt: Callable[[], None] = lambda: None
        """Called where what was on its way to us may have been lost."""
        self._identity, self._trust, self._gateway = identity, trust, gateway
        self._routers, self._listen = routers, listen
        self._interfaces = tuple(interfaces)
        self.at_once = tuple(interfaces) if links else ()
        """The interfaces that have a session each."""
        self._max_bytes = max_message_bytes + OVERLAY_ROUTED_BYTES - OVERLAY_MESSAGE_BYTES
        self._link_s = link_s
        self._mute = self._looks_alone = 0
        self._connection, self._made_again = 0, float("-inf")
        self._company: float | None = None  # when others were known last
        self._mended, self._mend_again_s = float("-inf"), _MEND_S
        self._watching: Supervised | None = None
        self.denied = self._to_deny()
        self.main = Fabric(self._config(self.denied), gateway, routers=routers)
        self._others: dict[str, Fabric] = {}
        self.fabric: DataPlane = self.main
        if self.at_once:
            for way, name in enumerate(self.at_once[1:], 1):
                config = self._other_config(name, gateway_id())
                self._others[name] = Fabric(config, gateway, routers=routers, way=way)
            sessions = {self.at_once[0]: self.main, **self._others}
            self.fabric = LinkedSessions(sessions, duplicate=links == "duplicate", on_doubt=lambda: self.on_doubt())

    def answer_probes(self) -> Handle:
        """Answer the probes of gateways that are linked with us."""
        return self.main.answer_probes()

    def watch(self) -> None:
        """Report from now on why there is no link, whenever there is none."""
        self._watching = Supervised(self._watch, "overlay links").start()

    async def close(self) -> None:
        """Stop reporting."""
        await end(self._watching)
        self._watching = None

    async def wait(self, timeout_s: float) -> None:
        """Wait for a link with a router or another gateway. Raises ``GraphUnavailable`` that says why there is none."""
        if not await self.fabric.linked(timeout_s):
            raise GraphUnavailable("overlay", await unreachable(self._identity, self._routers))

    async def first(self) -> bool:
        """Wait a moment for the first link; return whether there is one with whom to learn who was revoked."""
        return bool(self._routers) and await self.fabric.linked(_FIRST_LINK_S)

    async def _watch(self) -> None:
        while self._routers:
            if await self.fabric.linked(self._link_s):
                if self.unlinked:
                    log.info("overlay: linked")
                self.unlinked = ""
                await asyncio.sleep(_LOOK_S)
                continue
            why = await unreachable(self._identity, self._routers)
            if why != self.unlinked:
                log.warning("overlay: %s", why)
            self.unlinked = why

    # ── who was revoked ────────────────────────────────────────────────────────────────────────────────────────

    def _to_deny(self) -> frozenset[str]:
        """Return the names whose links shall carry nothing; denying our own would help nobody."""
        return self._trust.denied - {self._identity.name}

    def _config(self, denied: frozenset[str]) -> zenoh.Config:
        return gateway_config(
            self._identity,
            gateway=self._gateway,
            connect=by_interface(self._routers, self.at_once[:1] or self._interfaces),
            listen=self._listen,
            max_message_bytes=self._max_bytes,
            denied=denied,
        )

    def client_config(self, id: bytes) -> zenoh.Config:
        """Build the configuration of another session of this gateway, with a router alone, by the last interface."""
        connect = by_interface(self._routers, self._interfaces[::-1])
        return client_config(self._identity, id=id, connect=connect, denied=self._to_deny())

    def _other_config(self, interface: str, id: bytes) -> zenoh.Config:
        """Build the configuration of the session that goes by one of several interfaces beside the first."""
        connect = by_interface(self._routers, [interface])
        return client_config(self._identity, id=id, connect=connect, denied=self._to_deny())

    async def _make_anew(self, denied: frozenset[str]) -> None:
        """Make all links anew; those by other interfaces that cannot be made now are made later."""
        await self.main.reopen(self._config(denied))
        for name, fabric in self._others.items():
            with contextlib.suppress(GraphUnavailable):
                await fabric.reopen(self._other_config(name, gateway_id()))

    async def deny(self) -> None:
        """Make links anew where they could carry something for who was revoked."""
        denied = self._to_deny()
        if denied != self.denied and (self._listen or self.fabric.linked_with(denied)):
            log.info("overlay: links are made anew, to carry nothing for %s", ", ".join(sorted(denied)) or "nobody")
            await self._make_anew(denied)
            self.denied = denied

    # ── where Zenoh fails ──────────────────────────────────────────────────────────────────────────────────────

    def heard(self, answers: int) -> bool:
        """Count how many answered what we answer ourselves, too; return false where it is to be asked again."""
        self._mute = 0 if answers else self._mute + 1
        return bool(answers)

    def in_company(self, gateways: int) -> None:
        """Take note of how many other gateways are known.

        A router may take a member off its map that comes again before the old link is closed there: then the link is
        up, and soon nobody is heard of over it.
        """
        now, connection = asyncio.get_running_loop().time(), self.fabric.connection
        if connection not in (0, self._connection):
            self._made_again = now if self._connection else float("-inf")
            self._connection = connection
        if gateways:
            self._company, self._looks_alone = now, 0
        elif connection and self._company is not None and self._company - self._made_again < _SOON_S:
            self._looks_alone += 1

    async def mend(self, lost: bytes | None) -> None:
        """Make links anew where Zenoh answers nothing any more, or has lost the way to a gateway, or to all of them.

        Ever more rarely, lest a member that invents gateways keep us busy.
        """
        now = asyncio.get_running_loop().time()
        deserted = self._looks_alone >= _DESERTED
        if not (self._mute >= _MUTE or lost is not None or deserted) or now - self._mended < self._mend_again_s:
            return
        if lost is not None:
            what = f"there is no way to gateway {lost.hex()[:8]}"
        elif deserted:
            what = "nobody is heard of any more since the link was made again"
            self._company, self._looks_alone = None, 0  # perhaps all have left: once is enough
        else:
            what = "Zenoh has stopped answering"
        log.warning("overlay: %s; links are made anew", what)
        self._mended, self._mute = now, 0
        self._mend_again_s = min(2 * self._mend_again_s, _MEND_LIMIT_S)
        await self._make_anew(self.denied)
