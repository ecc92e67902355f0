"""The data plane as the rest of the overlay sees it: one Zenoh session, on the event loop.

Zenoh calls back in threads of its own. Incoming data is handed to the loop in batches; outgoing data goes through one
thread per lane, because a congested link blocks the thread that writes to it, so that only its own lane waits.
"""

from __future__ import annotations

import asyncio
import contextlib
import itertools
import logging
import threading
from collections.abc import Callable, Collection
from concurrent.futures import ThreadPoolExecutor
from typing import Any, Final, TypeVar

import zenoh

from ropeway import aio
from ropeway.errors import GraphUnavailable
from ropeway.graph.inlet import Inlet, one_by_one
from ropeway.limits import OVERLAY_NOTE_BYTES, OVERLAY_ROUTED_BYTES, OVERLAY_WAITING_NOTES_BYTES
from ropeway.networks.overlay.asked import Asked
from ropeway.networks.overlay.data_plane import Handle, Take
from ropeway.networks.overlay.link_sockets import Losses, set_options
from ropeway.networks.overlay.zenoh_config import MEMBER_DEAD_MS, PRIORITIES, ROUTER_DEAD_MS
from ropeway.networks.overlay.zenoh_failures import zenoh_failures
from ropeway.networks.overlay.zenoh_queries import answer_probes, ask, probe
from ropeway.tasks import Supervised, end

__all__ = ["Fabric"]

log = logging.getLogger("ropeway.overlay")

_CLOSE_S: Final = 5.0
_LET_GO_S: Final = 0.3  # routers compute their maps within 0.1 s; who comes back earlier may be left off them
_REOPEN_S: Final = 10.0  # what is sent waits so long for a new session
_LOOK_S: Final = 2.0  # at what links lose

_connections = itertools.count(1)

T = TypeVar("T")


class _Declared:
    """A declaration in a session, and how to repeat it."""

    def __init__(self, declare: Callable[[zenoh.Session], Any]) -> None:
        self.declare = declare
        self.made: Any = None


class Fabric:
    """A Zenoh session. ``gateway`` is our id in the overlay, 16 bytes; ``way`` is its number among those that we have.

    A link whose far end acknowledges nothing is given up, one to a router later than one to another gateway:
    ``routers`` are their endpoints.
    """

    def __init__(self, config: zenoh.Config, gateway: bytes, *, routers: Collection[str] = (), way: int = 0) -> None:
        self.way = way
        self._router_ports = {endpoint.rpartition(":")[2] for endpoint in routers}
        self.gateway = gateway
        self._config = config
        self._session: zenoh.Session | None = None
        self._lanes: dict[int, ThreadPoolExecutor] = {}
        self._link_events: Any = None
        self._linked: set[tuple[str, str]] = set()
        self.connection = 0
        """A number that is another with each link that is made, 0 while there is none."""
        self.router = ""
        """The id of the router that was linked last."""
        self._watching: Supervised | None = None
        self._declared: dict[_Declared, None] = {}
        self._open = asyncio.Event()
        self._ready = threading.Event()  # the same, for threads
        self._changing = asyncio.Lock()
        self._loop: asyncio.AbstractEventLoop

    async def open(self) -> None:
        """Start the session; it goes on trying to reach its routers. Raises ``GraphUnavailable``."""
        self._loop = asyncio.get_running_loop()
        async with self._changing:
            await self._start()

    async def _start(self) -> None:
        try:
            self._session = await asyncio.to_thread(zenoh.open, self._config)
        except zenoh.ZError as error:
            raise GraphUnavailable("overlay", f"Zenoh cannot start: {error}") from error
        self._link_events = self._session.info.declare_link_events_listener(self._link_changed, history=True)
        for declared in self._declared:
            declared.made = declared.declare(self._session)
        self._open.set()
        self._ready.set()
        if self._watching is None:
            self._watching = Supervised(self._watch, "overlay: losses of links").start()

    async def _watch(self) -> None:
        """Switch connections that lose packets to a congestion control that tolerates it."""
        losses = Losses()
        while True:
            await asyncio.sleep(_LOOK_S)
            if self._session is not None:
                losses.look({(str(link.src), str(link.dst)) for link in self._session.info.links()})

    async def reopen(self, config: zenoh.Config | None = None) -> None:
        """Open the session again, with another configuration if there is one: links and declarations are made anew.

        What is sent meanwhile waits. Raises ``GraphUnavailable`` where the session cannot start; may be called again.
        """
        async with self._changing:
            self._config = config or self._config
            await self._stop()
            await asyncio.sleep(_LET_GO_S)
            await self._start()

    async def close(self) -> None:
        """End the session; nothing is delivered after this returns."""
        async with self._changing:
            self._declared.clear()
            await end(self._watching)
            self._watching = None
            await self._stop()
        for lane in self._lanes.values():
            lane.shutdown(wait=False, cancel_futures=True)
        self._lanes.clear()

    async def _stop(self) -> None:
        self._open.clear()
        self._ready.clear()
        session, self._session = self._session, None
        listener, self._link_events = self._link_events, None
        if listener is not None:
            listener.undeclare()
        self.connection = 0
        self._linked.clear()
        if session is not None:
            try:
                with zenoh_failures():
                    async with aio.timeout(_CLOSE_S):
                        await asyncio.to_thread(session.close)
            except TimeoutError:
                log.warning("overlay: Zenoh did not close within %g s", _CLOSE_S)
            except GraphUnavailable as error:
                log.warning("overlay: Zenoh did not close: %s", error)
        for declared in self._declared:
            declared.made = None

    def _link_changed(self, event: zenoh.LinkEvent) -> None:
        """Handle a link event; runs in a thread of Zenoh's."""
        source, target = str(event.link.src), str(event.link.dst)
        if event.kind == zenoh.SampleKind.PUT:
            to_router = target.rpartition(":")[2] in self._router_ports
            set_options(source, target, MEMBER_DEAD_MS if to_router else ROUTER_DEAD_MS)
            if to_router:
                self.router = str(event.link.zid)
            self._linked.add((source, target))
            self.connection = next(_connections)
        else:
            self._linked.discard((source, target))
            if not self._linked:
                self.connection = 0

    def linked_with(self, names: Collection[str]) -> bool:
        """Return whether there is a link with one of these names in its certificate."""
        links = self._session.info.links() if self._session is not None else []
        return any(link.auth_identifier in names for link in links)

    @property
    def session(self) -> zenoh.Session:
        """The session. Raises ``GraphUnavailable`` where there is none."""
        if self._session is None:
            raise GraphUnavailable("overlay", "it is not open")
        return self._session

    # ── hearing ────────────────────────────────────────────────────────────────────────────────────────────────

    def subscribe(self, key: str, callback: Take) -> Handle:
        """See ``DataPlane``."""

        def take(sample: zenoh.Sample) -> None:
            callback(str(sample.key_expr), sample.payload, sample.attachment, self.way)

        handler = zenoh.handlers.Callback(take, indirect=False)
        return self._declare(lambda session: session.declare_subscriber(key, handler))

    def hear(
        self, key: str, callback: Callable[[str, bytes], None], *, limit_bytes: int = OVERLAY_NOTE_BYTES
    ) -> Handle:
        """Subscribe with a callback on the loop, for payloads of ``limit_bytes`` at most."""
        inlet: Inlet[tuple[str, bytes]] = Inlet(self._loop, one_by_one(lambda item: callback(*item)))

        def take(key: str, payload: zenoh.ZBytes, _: object, __: int) -> None:
            if len(payload) <= limit_bytes:
                inlet.put((key, bytes(payload)), len(payload))
            else:
                inlet.lost += 1

        end = self.subscribe(key, take)

        def close() -> None:
            inlet.closed = True
            end()

        return close

    def watch(self, key: str, callback: Callable[[str, bool], None]) -> Handle:
        """Call ``callback(key, alive)`` on the loop for tokens that come and go, and are there now."""
        inlet: Inlet[tuple[str, bool]] = Inlet(self._loop, one_by_one(lambda item: callback(*item)))

        def take(sample: zenoh.Sample) -> None:
            inlet.put((str(sample.key_expr), sample.kind == zenoh.SampleKind.PUT))

        handler = zenoh.handlers.Callback(take, indirect=False)
        end = self._declare(lambda session: session.liveliness().declare_subscriber(key, handler, history=True))

        def close() -> None:
            inlet.closed = True
            end()

        return close

    def serve(
        self, key: str, callback: Callable[[Asked], None], *, limit_bytes: int = OVERLAY_WAITING_NOTES_BYTES
    ) -> Handle:
        """Call ``callback`` on the loop for each query of ``key``; ``limit_bytes`` of them may wait for it."""
        inlet: Inlet[Asked] = Inlet(self._loop, one_by_one(callback), limit_bytes=limit_bytes, on_lost=Asked.done)

        def take(query: zenoh.Query) -> None:
            asked = Asked(query)
            inlet.put(asked, len(asked.payload))

        handler = zenoh.handlers.Callback(take, indirect=False)
        end = self._declare(lambda session: session.declare_queryable(key, handler, complete=True))

        def close() -> None:
            inlet.closed = True
            end()

        return close

    def token(self, key: str) -> Handle:
        """Show that we are alive under ``key``."""
        return self._declare(lambda session: session.liveliness().declare_token(key))

    def _declare(self, declare: Callable[[zenoh.Session], Any]) -> Handle:
        """Declare something now, and again with every new session until it is ended."""
        declared = _Declared(declare)
        if not self._changing.locked():  # else it is declared with the rest
            with zenoh_failures():
                declared.made = declare(self.session)
        self._declared[declared] = None

        def end() -> None:
            self._declared.pop(declared, None)
            made, declared.made = declared.made, None
            if made is not None:
                with contextlib.suppress(zenoh.ZError):  # the session has closed
                    made.undeclare()

        return end

    # ── telling ────────────────────────────────────────────────────────────────────────────────────────────────

    def tell(self, key: str, payload: bytes, *, copies: bool = False) -> None:
        """See ``DataPlane``; there is one way, so there are no copies."""
        if self._session is None:
            return
        with zenoh_failures():
            self._session.put(
                key,
                payload,
                congestion_control=zenoh.CongestionControl.DROP,
                priority=zenoh.Priority.INTERACTIVE_HIGH,
            )

    def short(self, key: str) -> zenoh.KeyExpr:
        """Return a key that goes over each link once, and as a number from then on; see ``forget``."""
        self._ready.wait(_REOPEN_S)
        made: zenoh.KeyExpr = self.session.declare_keyexpr(key)
        return made

    def forget(self, key: zenoh.KeyExpr) -> None:
        """Take a short key back."""
        if self._session is not None:
            with contextlib.suppress(zenoh.ZError):
                self._session.undeclare(key)

    def put(
        self,
        lane: int,
        key: str | zenoh.KeyExpr,
        payload: bytes,
        mark: bytes | None = None,
        *,
        copies: bool = False,
    ) -> None:
        """See ``DataPlane``; there is one way, so there are no copies."""
        self._ready.wait(_REOPEN_S)
        self.session.put(
            key,
            payload,
            attachment=mark,
            congestion_control=zenoh.CongestionControl.BLOCK,
            priority=PRIORITIES[lane],
            express=True,
        )

    def offer(self, lane: int, key: str, payload: bytes, mark: bytes) -> None:
        """Put data that may be lost where the link is congested or has gone; from any thread."""
        session = self._session
        if session is not None:
            with contextlib.suppress(zenoh.ZError), zenoh_failures():  # it has closed this moment
                session.put(
                    key,
                    payload,
                    attachment=mark,
                    congestion_control=zenoh.CongestionControl.DROP,
                    priority=PRIORITIES[lane],
                    express=True,
                )

    def in_lane(self, lane: int, work: Callable[[], T]) -> asyncio.Future[T]:
        """Run ``work`` in the thread of a lane, in order."""
        executor = self._lanes.get(lane)
        if executor is None:
            executor = self._lanes[lane] = ThreadPoolExecutor(1, thread_name_prefix=f"overlay-lane-{lane}")
        return self._loop.run_in_executor(executor, work)

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
        """See ``DataPlane``. Where links are made anew all that time, nobody answers."""
        with contextlib.suppress(TimeoutError):
            async with aio.timeout(min(timeout_s, _REOPEN_S)):
                await self._open.wait()
        session = self._session
        if session is None:
            return []
        return await ask(session, key, payload, timeout_s, lane=lane, limit_bytes=limit_bytes, first=first)

    def answer_probes(self) -> Handle:
        """Answer probes of the links with us."""
        return self._declare(answer_probes)

    def probe(self, timeout_s: float, answered: Callable[[float], None]) -> None:
        """Ask our router for a sign of life; call ``answered`` on the loop with the round trip in seconds."""
        if self._session is not None and self.router:
            probe(self._session, self.router, timeout_s, answered, self._loop)

    async def linked(self, timeout_s: float) -> bool:
        """Wait until a router or another gateway is linked with us; false when the time is over."""
        changed = asyncio.Event()
        changed.set()
        inlet: Inlet[None] = Inlet(self._loop, lambda _: changed.set())
        listener = None
        try:
            async with aio.timeout(timeout_s):
                await self._open.wait()
                with zenoh_failures():
                    listener = self.session.info.declare_transport_events_listener(lambda _: inlet.put(None))
                while not self.links():
                    await changed.wait()
                    changed.clear()
        except TimeoutError:
            return False
        except GraphUnavailable:  # it has failed, or was closed this moment
            await asyncio.sleep(timeout_s)
            return False
        finally:
            inlet.closed = True
            if listener is not None:
                with contextlib.suppress(zenoh.ZError):  # the session has closed
                    listener.undeclare()  # type: ignore[no-untyped-call]
        return True

    # ── where ──────────────────────────────────────────────────────────────────────────────────────────────────

    def links(self) -> set[str]:
        """See ``DataPlane``."""
        return {str(zid) for zid in self._session.info.routers_zid()} if self._session is not None else set()

    @property
    def is_open(self) -> bool:
        """Whether there is a session."""
        return self._session is not None

    def status(self) -> dict[str, Any]:
        """See ``DataPlane``."""
        return {}
