"""A router of the overlay in this process: Zenoh, for certificates of one fleet and for nobody else.

It sees 256-bit names, sizes and times. It cannot read or make what travels, and need not be trusted with it.
"""

from __future__ import annotations

import asyncio
import contextlib
import logging
import os
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

from ropeway import aio
from ropeway.errors import GraphUnavailable, IdentityError, RopewayError, SealError
from ropeway.limits import OVERLAY_CRL_BYTES
from ropeway.networks.overlay.asked import Asked
from ropeway.networks.overlay.crypto.identity import Identity
from ropeway.networks.overlay.crypto.trust import Trust
from ropeway.networks.overlay.data_plane import CRL_KEY, Handle
from ropeway.networks.overlay.fabric import Fabric
from ropeway.networks.overlay.zenoh_config import gateway_config, gateway_id, router_config
from ropeway.tasks import Supervised, end

if TYPE_CHECKING:
    import zenoh

__all__ = ["Router", "push_crl"]

log = logging.getLogger("ropeway.overlay")

_ASK_S: Final = 2.0
_LOOK_S: Final = 10.0
_MUTE: Final = 2  # requests in a row that not even we answered: Zenoh has failed
_LINK_S: Final = 8.0


class Router:
    """``async with Router(identity, listen=["tls/0.0.0.0:7447"]) as router: await router.wait()``.

    ``connect`` are other routers to mesh with. ``crl`` is a file with a revocation list that is read again when it
    changes; ``state`` is where the newest list that was heard of is kept. ``on_change`` is told what changes, as a
    sentence.
    """

    def __init__(
        self,
        identity: Identity,
        *,
        listen: Sequence[str],
        connect: Sequence[str] = (),
        crl: Path | None = None,
        state: Path | None = None,
        look_s: float = _LOOK_S,
        on_change: Callable[[str], None] | None = None,
    ) -> None:
        if identity.certificate.role != "router":
            raise IdentityError(identity.name, "it is not a router; issue it with: ropeway keys issue NAME --router")
        self.identity = identity
        self.trust = Trust(identity.ca, identity.crl)
        self.trust.check(identity.certificate.der, role="router")
        self.listen, self.connect = tuple(listen), tuple(connect)
        self._crl, self._state, self._look_s = crl, state, look_s
        self._say = on_change or log.info
        self._fabric: Fabric | None = None
        self._denied: frozenset[str] = frozenset()
        self._ends: list[Handle] = []
        self._newer = asyncio.Event()
        self._task = Supervised(self._keep, "router")

    async def __aenter__(self) -> Router:
        """Start to listen. Raises ``GraphUnavailable`` where that cannot be."""
        self._read_files()
        await self._open()
        self._task.start()
        return self

    async def __aexit__(self, *_: object) -> None:
        """End."""
        await end(self._task)
        await self._close()

    async def wait(self) -> None:
        """Run until cancelled."""
        await self._task.wait()

    def look(self) -> None:
        """Read the files of revocation lists now, and deny whom they deny."""
        self._read_files()
        self._newer.set()

    def status(self) -> dict[str, Any]:
        """Return the state of the router, for people and programs."""
        return {
            "name": self.identity.name,
            "fleet": self.identity.fleet,
            "listen": list(self.listen),
            "connect": list(self.connect),
            "links": sorted(self._fabric.links()) if self._fabric is not None else [],
            "revocations": self.trust.crl_number,
            "denied": sorted(self._denied),
        }

    # ── the session ────────────────────────────────────────────────────────────────────────────────────────────

    async def _open(self) -> None:
        self._denied = self.trust.denied
        fabric = Fabric(self._config(self._denied), b"")
        await fabric.open()
        self._fabric = fabric
        take = fabric.hear(CRL_KEY, lambda _, raw: self._take(raw), limit_bytes=OVERLAY_CRL_BYTES)
        self._ends = [fabric.serve(CRL_KEY, self._tell), take, fabric.answer_probes()]

    def _config(self, denied: frozenset[str]) -> zenoh.Config:
        return router_config(self.identity, connect=self.connect, listen=self.listen, denied=denied)

    async def _make_links(self) -> None:
        """Make all links anew, with nothing for those that the list denies."""
        assert self._fabric is not None
        denied = self.trust.denied
        await self._fabric.reopen(self._config(denied))
        self._denied = denied

    async def _close(self) -> None:
        for handle in self._ends:
            handle()
        self._ends.clear()
        if self._fabric is not None:
            await self._fabric.close()
            self._fabric = None

    async def _keep(self) -> None:
        """Ask other routers for their list; begin anew when a list denies other names than before, or Zenoh fails."""
        mute = 0
        while True:
            mute = 0 if await self._ask() else mute + 1
            if mute >= _MUTE:
                log.warning("router: Zenoh has stopped answering; links are made anew")
                mute = 0
                await self._make_links()
            if self.trust.denied != self._denied:
                names = ", ".join(sorted(self.trust.denied)) or "nobody"
                self._say(f"revocation list {self.trust.crl_number} denies {names}")
                await self._make_links()
            self._newer.clear()
            with contextlib.suppress(TimeoutError):
                async with aio.timeout(self._look_s):
                    await self._newer.wait()
            self._read_files()

    async def _ask(self) -> int:
        """Ask for the newest list; return how many answered, we among them."""
        fabric = self._fabric
        assert fabric is not None
        try:
            answers = await fabric.ask(CRL_KEY, b"", _ASK_S)
        except RopewayError as error:
            log.debug("router: no other router told which certificates are revoked: %s", error)
            return 0
        for raw in answers:
            self._take(raw)
        return len(answers)

    # ── revocation ─────────────────────────────────────────────────────────────────────────────────────────────

    def _tell(self, asked: Asked) -> None:
        asked.answer(self.trust.crl)

    def _take(self, raw: bytes) -> None:
        if not raw:
            return
        try:
            newer = self.trust.update(raw)
        except SealError as error:
            log.warning("router: a revocation list is refused: %s", error)
            return
        if newer:
            self._newer.set()
            self._save()

    def _read_files(self) -> None:
        for path in (self._crl, self._state):
            if path is not None and path.exists():
                try:
                    self._take(path.read_bytes())
                except OSError as error:
                    log.warning("router: %s cannot be read: %s", path, error)

    def _save(self) -> None:
        if self._state is None:
            return
        new = self._state.with_name(f".{self._state.name}.{os.getpid()}")
        try:
            with os.fdopen(os.open(new, os.O_WRONLY | os.O_CREAT | os.O_TRUNC, 0o600), "wb") as file:
                file.write(self.trust.crl)
            new.replace(self._state)
        except OSError as error:
            log.warning("router: the revocation list cannot be kept in %s: %s", self._state, error)


async def push_crl(
    identity: Identity, crl: bytes, *, routers: Sequence[str] | None = None, link_s: float = _LINK_S
) -> int:
    """Tell the overlay of a revocation list; how many routers and gateways have it now.

    Raises ``GraphUnavailable`` where no router can be reached within ``link_s``.
    """
    number = Trust(identity.ca, crl).crl_number
    where = tuple(identity.routers if routers is None else routers)
    gateway = gateway_id()
    fabric = Fabric(gateway_config(identity, gateway=gateway, connect=where, listen=()), gateway)
    await fabric.open()
    try:
        if not await fabric.linked(link_s):
            raise GraphUnavailable("overlay", f"none of {', '.join(where) or 'no router'} can be reached")
        pause_s, have = 0.05, 0
        while not have and pause_s < 4.0:  # a link is there a moment before the way beyond it
            await asyncio.to_thread(fabric.put, 1, CRL_KEY, crl)
            answers = await fabric.ask(CRL_KEY, b"", _ASK_S)
            have = sum(Trust(identity.ca, raw).crl_number >= number for raw in answers if raw)
            if not have:
                await asyncio.sleep(pause_s)
                pause_s *= 2
        return have
    finally:
        await fabric.close()
