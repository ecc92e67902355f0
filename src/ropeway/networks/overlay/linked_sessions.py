"""Several links at once: a Zenoh session on each network interface, as one data plane.

Each link is probed; ``LinkChoice`` says which is the best at the moment. With *best* everything goes by that one, and
is subscribed to there; when it changes, the new one is subscribed to before the old one is let go of. While it is
doubted everything goes by another one as well, which first gets what may have been lost. With *duplicate*
data goes by all of them, both ways, and whichever copy comes first counts. Calls and queries go by the best link in
both cases, and by the next one if that link falls silent before they are answered. We are alive while one link is: each
session shows our token.
"""

from __future__ import annotations

import asyncio
import logging
import threading
import time
from collections import OrderedDict
from collections.abc import Callable, Collection, Mapping
from functools import partial
from typing import TYPE_CHECKING, Any, Final, TypeVar

from ropeway.errors import GraphUnavailable
from ropeway.group.link_choice import BREAK_S, LinkChoice
from ropeway.group.recent import Recent
from ropeway.limits import OVERLAY_NOTE_BYTES, OVERLAY_ROUTED_BYTES, OVERLAY_WAITING_NOTES_BYTES
from ropeway.networks.overlay.arrivals import NoteCopies
from ropeway.networks.overlay.asked import Asked
from ropeway.networks.overlay.data_plane import Handle, Take
from ropeway.networks.overlay.fabric import Fabric
from ropeway.networks.overlay.link_lanes import LinkLanes
from ropeway.networks.overlay.packet_mark import by_way
from ropeway.tasks import Supervised, end

if TYPE_CHECKING:
    import zenoh

__all__ = ["LinkedSessions"]

log = logging.getLogger("ropeway.overlay")

_PROBE_TIMEOUT_S: Final = 2.0
_AGAIN_S: Final = 1.0  # between two attempts to open a session
_UNLINKED_S: Final = 8.0  # a session that has no link for so long is opened anew
_ASKED: Final = 256  # queries that may come by another link, too: those of a second and more

T = TypeVar("T")


class _Declared:
    """Holds what is declared in sessions. ``everywhere``: in all of them, else in that of the link in use."""

    def __init__(self, declare: Callable[[Fabric], Handle], *, everywhere: bool) -> None:
        self.declare, self.everywhere = declare, everywhere
        self.on: dict[str, Handle] = {}


class LinkedSessions:
    """A session for each of ``fabrics``, by interface. The first of them takes direct links, too.

    ``duplicate``: data goes by all, and not by the best alone. Otherwise ``on_doubt`` is called where what was on its
    way to us may have been lost, once it can be asked for by another link.
    """

    def __init__(
        self,
        fabrics: Mapping[str, Fabric],
        *,
        duplicate: bool = False,
        on_doubt: Callable[[], None] = lambda: None,
    ) -> None:
        self.duplicate = duplicate
        self._on_doubt = on_doubt
        self._fabrics = dict(fabrics)
        self._first = next(iter(self._fabrics.values()))
        self.gateway = self._first.gateway
        self.using = next(iter(self._fabrics))
        self.beside = ""
        """The link that carries everything as well while the one in use is doubted; ``""`` for none."""
        self.choice = LinkChoice(self._fabrics)
        self._recent: Recent[tuple[int, str | zenoh.KeyExpr, bytes, bytes]] = Recent()
        self._sending = threading.Lock()  # of which links a packet goes by, and whether it goes again
        self._connections = dict.fromkeys(self._fabrics, 0)
        self._lanes = LinkLanes()
        self._copies = NoteCopies()
        self._declared: dict[_Declared, None] = {}
        self._changed_s = float("-inf")
        self._spread_at_s = float("inf")  # when something is to be let go of
        self._changed = asyncio.Event()
        self._running: list[Supervised] = []

    async def open(self) -> None:
        """See ``DataPlane``; a link beside the first that cannot be made is tried again and again."""
        await self._first.open()
        for name, fabric in self._fabrics.items():
            if fabric is not self._first:
                self._running.append(Supervised(partial(self._keep_open, name, fabric), f"overlay by {name}").start())
        self._running.append(Supervised(self._keep_probing, "probes of the overlay's links").start())

    async def close(self) -> None:
        """See ``DataPlane``."""
        await end(*self._running)
        self._running.clear()
        self._declared.clear()
        self._lanes.close()
        await asyncio.gather(*(fabric.close() for fabric in self._fabrics.values()))

    # ── which links ────────────────────────────────────────────────────────────────────────────────────────────

    async def _keep_open(self, name: str, fabric: Fabric) -> None:
        """Open the session of a link, and open it anew where Zenoh has given up on it."""
        unlinked_s = 0.0
        while True:
            try:
                if not fabric.is_open:
                    await fabric.open()
                    self._spread()
                elif unlinked_s >= _UNLINKED_S:
                    unlinked_s = 0.0
                    await fabric.reopen()
            except GraphUnavailable as error:
                log.debug("overlay: no router is reached by %s: %s", name, error)
            await asyncio.sleep(_AGAIN_S)
            unlinked_s = 0.0 if fabric.connection else unlinked_s + _AGAIN_S

    async def _keep_probing(self) -> None:
        while True:
            now_s = time.monotonic()
            due = self.choice.due(now_s)
            for name, fabric in self._fabrics.items():
                connection = fabric.connection
                if connection != self._connections[name]:
                    self._connections[name] = connection
                    self.choice.up(name, connection > 0)
                if connection and due:
                    self.choice.sent(name, now_s)
                    fabric.probe(_PROBE_TIMEOUT_S, partial(self._probed, name, connection))
            self._choose(now_s)
            await asyncio.sleep(self.choice.pause_s(time.monotonic()))

    def _choose(self, now_s: float) -> None:
        best = self.choice.step(now_s) or self.using
        beside = "" if self.duplicate else self.choice.beside
        if best != self.using or beside != self.beside:
            self._use(best, beside, now_s)
        elif now_s >= self._spread_at_s:
            self._spread()

    def _probed(self, name: str, connection: int, round_trip_s: float) -> None:
        if self._connections[name] == connection:
            self.choice.came(name, round_trip_s, time.monotonic())

    def _use(self, name: str, beside: str, now_s: float) -> None:
        before, beside_before = self.using, self.beside
        doubted = bool(beside) or (not beside_before and self.choice.silent(before, now_s))
        with self._sending:
            if doubted and not self.duplicate:
                self._send_again(beside or name, self.choice.answered_s(before))
            elif name != before:
                self._recent.forget()  # none of it goes by the link before a second time
            self.using, self.beside = name, beside
        if name != before:
            log.info("overlay: %s is used from now on; %s was", name, before)
            self._changed_s = now_s
        self._spread()
        if doubted and not self.duplicate:
            self._on_doubt()
        if name != before:
            changed, self._changed = self._changed, asyncio.Event()
            changed.set()

    def _send_again(self, name: str, since_s: float) -> None:
        """Send by a link what may not have arrived by another, before anything else goes by it."""
        fabric = self._fabrics[name]
        for lane, key, payload, mark in self._recent.take(since_s):
            put = partial(fabric.put, lane, key, payload, by_way(mark, fabric.way))
            self._lanes.put_soon(lane, len(payload), name, put)

    def _spread(self) -> None:
        """Declare everything where it belongs, and after a moment no longer where it belonged before."""
        now_s = time.monotonic()
        over = now_s - self._changed_s >= BREAK_S
        self._spread_at_s = float("inf") if over else self._changed_s + BREAK_S
        for declared in list(self._declared):
            for name, fabric in self._fabrics.items():
                wanted = declared.everywhere or name in (self.using, self.beside)
                if wanted and name not in declared.on and fabric.is_open:
                    declared.on[name] = declared.declare(fabric)
                elif not wanted and over and name in declared.on:
                    declared.on.pop(name)()

    def _declare(self, declare: Callable[[Fabric], Handle], *, everywhere: bool) -> Handle:
        declared = _Declared(declare, everywhere=everywhere)
        self._declared[declared] = None
        try:
            self._spread()
        except GraphUnavailable:
            self._declared.pop(declared, None)
            raise

        def end() -> None:
            self._declared.pop(declared, None)
            for handle in declared.on.values():
                handle()
            declared.on.clear()

        return end

    # ── hearing ────────────────────────────────────────────────────────────────────────────────────────────────

    def subscribe(self, key: str, callback: Take) -> Handle:
        """See ``DataPlane``; what comes by several links has the number of each beside it."""
        return self._declare(lambda fabric: fabric.subscribe(key, callback), everywhere=self.duplicate)

    def hear(
        self, key: str, callback: Callable[[str, bytes], None], *, limit_bytes: int = OVERLAY_NOTE_BYTES
    ) -> Handle:
        """See ``DataPlane``; what comes by several links is told once."""

        def declare(fabric: Fabric) -> Handle:
            def take(key: str, payload: bytes) -> None:
                if not self._copies.is_copy(fabric.way, key, payload):
                    callback(key, payload)

            return fabric.hear(key, take, limit_bytes=limit_bytes)

        return self._declare(declare, everywhere=self.duplicate)

    def watch(self, key: str, callback: Callable[[str, bool], None]) -> Handle:
        """See ``DataPlane``; a token is there while it is seen by one link."""
        seen: dict[str, set[int]] = {}

        def declare(fabric: Fabric) -> Handle:
            def take(key: str, alive: bool) -> None:
                by = seen.setdefault(key, set())
                before = bool(by)
                if alive:
                    by.add(fabric.way)
                else:
                    by.discard(fabric.way)
                if not by:
                    del seen[key]
                if before != bool(by):
                    callback(key, bool(by))

            return fabric.watch(key, take)

        return self._declare(declare, everywhere=True)

    def serve(
        self, key: str, callback: Callable[[Asked], None], *, limit_bytes: int = OVERLAY_WAITING_NOTES_BYTES
    ) -> Handle:
        """See ``DataPlane``; a query that comes by several links is told once, and answered by all of them."""
        asked_before: OrderedDict[bytes, Asked] = OrderedDict()

        def declare(fabric: Fabric) -> Handle:
            def take(asked: Asked) -> None:
                if asked.payload and self._copies.is_copy(fabric.way, key, asked.payload):
                    first = asked_before.get(asked.payload)
                    if first is None:
                        asked.done()
                    else:
                        first.join(asked)
                    return
                asked_before[asked.payload] = asked
                if len(asked_before) > _ASKED:
                    asked_before.popitem(last=False)
                callback(asked)

            return fabric.serve(key, take, limit_bytes=limit_bytes)

        return self._declare(declare, everywhere=self.duplicate)

    def token(self, key: str) -> Handle:
        """See ``DataPlane``."""
        return self._declare(lambda fabric: fabric.token(key), everywhere=True)

    # ── telling ────────────────────────────────────────────────────────────────────────────────────────────────

    @property
    def _used(self) -> Fabric:
        return self._fabrics[self.using]

    @property
    def connection(self) -> int:
        """See ``DataPlane``: that of the link in use."""
        return self._used.connection

    def tell(self, key: str, payload: bytes, *, copies: bool = False) -> None:
        """See ``DataPlane``."""
        for name, fabric in self._fabrics.items():
            if name == self.using or (copies and (self.duplicate or name == self.beside)):
                fabric.tell(key, payload)

    def short(self, key: str) -> zenoh.KeyExpr:
        """See ``DataPlane``: it is short by the link in use now."""
        return self._used.short(key)

    def forget(self, key: zenoh.KeyExpr) -> None:
        """See ``DataPlane``."""
        for fabric in self._fabrics.values():
            fabric.forget(key)

    def put(
        self,
        lane: int,
        key: str | zenoh.KeyExpr,
        payload: bytes,
        mark: bytes | None = None,
        *,
        copies: bool = False,
    ) -> None:
        """See ``DataPlane``; returns when one link has taken it, or another link comes into use meanwhile."""
        if not copies or mark is None:
            using = self.using
            puts = {using: partial(self._fabrics[using].put, lane, key, payload, mark)}
            self._lanes.put(lane, len(payload), puts, lambda: self.using == using)
            return
        with self._sending:
            using, beside = self.using, self.beside
            if not self.duplicate and not beside:
                self._recent.note((lane, key, payload, mark), len(payload), time.monotonic())
        puts = {
            name: partial(fabric.put, lane, key, payload, by_way(mark, fabric.way))
            for name, fabric in self._fabrics.items()
            if name in (using, beside) or (self.duplicate and fabric.connection)
        }
        self._lanes.put(
            lane, len(payload), puts, lambda: len(puts) > 1 or (self.using == using and self.beside == beside)
        )

    def in_lane(self, lane: int, work: Callable[[], T]) -> asyncio.Future[T]:
        """See ``DataPlane``."""
        return self._first.in_lane(lane, work)

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
        """See ``DataPlane``. Where the link falls silent meanwhile nobody answers; whoever asked may ask again."""
        using = self.beside or self.using
        fabric = self._fabrics[using]
        asking = asyncio.ensure_future(
            fabric.ask(key, payload, timeout_s, lane=lane, limit_bytes=limit_bytes, first=first)
        )
        try:
            while not asking.done():
                changed = asyncio.ensure_future(self._changed.wait())
                try:
                    await asyncio.wait((asking, changed), return_when=asyncio.FIRST_COMPLETED)
                finally:
                    await end(changed)
                if not asking.done() and self.choice.silent(using, time.monotonic()):
                    return []
            return asking.result()
        finally:
            await end(asking)

    async def linked(self, timeout_s: float) -> bool:
        """See ``DataPlane``: by any of the links."""
        fabrics = [fabric for fabric in self._fabrics.values() if fabric is self._first or fabric.is_open]
        waits = [asyncio.ensure_future(fabric.linked(timeout_s)) for fabric in fabrics]
        try:
            for linked in asyncio.as_completed(waits):
                if await linked:
                    return True
            return False
        finally:
            await end(*waits)

    # ── where ──────────────────────────────────────────────────────────────────────────────────────────────────

    def linked_with(self, names: Collection[str]) -> bool:
        """See ``DataPlane``."""
        return any(fabric.linked_with(names) for fabric in self._fabrics.values())

    def links(self) -> set[str]:
        """See ``DataPlane``."""
        return {id for fabric in self._fabrics.values() for id in fabric.links()}

    def status(self) -> dict[str, Any]:
        """See ``DataPlane``."""
        return {
            "links": "duplicate" if self.duplicate else "best",
            "current": self.using,
            "beside": self.beside,
            "members": self.choice.status(time.monotonic()),
            "left_out": self._lanes.left_out,
        }
