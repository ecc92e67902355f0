"""Decides who serves a service or an action that several want to serve: one name, one provider.

The first claim to a name holds it. Other claims wait and are told who holds it; the next one takes over when the holder
leaves. An earlier provider on the network takes precedence as well, so that two gateways that reserve the same service
on one network do not both answer; two that begin at the same time discover each other a moment later, and the younger
(by the time in its announcement, then by its id) gives way.
"""

from __future__ import annotations

import asyncio
import logging
import time
from collections.abc import Awaitable, Callable, Sequence
from typing import Any, Final, Generic, Protocol, TypeVar

from ropeway.errors import RopewayError
from ropeway.graph.calls import ActionInfo, ProviderInfo, ServiceInfo

__all__ = ["Claim", "Claimant", "NameOwners"]

log = logging.getLogger("ropeway.hub")

_YIELDS_S: Final = 2.0  # discovery takes its time: who appears so soon after us was there before


class _Closable(Protocol):
    async def close(self) -> None: ...


P = TypeVar("P")


class Claim(Generic[P]):
    """A claim to serve ``name``. ``create`` makes the provider on the graph once the name is free."""

    def __init__(self, name: str, user: str, provider: P, create: Callable[[], Awaitable[_Closable]]) -> None:
        self.name, self.user, self.provider = name, user, provider
        self.taken_by = ""
        self.inner: _Closable | None = None
        self.since_ns = 0
        self.closed = False
        self._create = create
        self._callbacks: list[Callable[[str], None]] = []

    @property
    def serving(self) -> bool:
        """Whether this claim holds the name."""
        return self.inner is not None and not self.closed

    def on_state(self, callback: Callable[[str], None]) -> None:
        """Call with who holds the name, ``""`` for this one, now and at each change."""
        self._callbacks.append(callback)
        callback(self.taken_by)

    def report(self, taken_by: str) -> None:
        """Record that ``taken_by`` holds the name, and tell the callbacks about a change."""
        if taken_by != self.taken_by:
            self.taken_by = taken_by
            for callback in self._callbacks:
                callback(taken_by)

    async def resume(self) -> None:
        """Take the name. Raises what the graph raises."""
        self.since_ns = time.time_ns()
        self.inner = await self._create()

    async def suspend(self) -> None:
        """Give the name back."""
        inner, self.inner = self.inner, None
        if inner is not None:
            await inner.close()


class Claimant:
    """A provider of a view, which has the name as its claim ``entry`` says."""

    def __init__(self, entry: Claim[Any]) -> None:
        self.entry = entry
        self.on_closed: Callable[[], None] | None = None

    @property
    def closed(self) -> bool:
        """Whether ``close`` was called."""
        return self.entry.closed

    @property
    def taken_by(self) -> str:
        """The other provider that holds the name, ``""`` while this one serves it."""
        return self.entry.taken_by

    def on_state(self, callback: Callable[[str], None]) -> None:
        """Call with ``taken_by``, now and at each change."""
        self.entry.on_state(callback)

    def _tell_closed(self) -> None:
        if self.on_closed is not None:
            self.on_closed()


class NameOwners(Generic[P]):
    """The holders of all names of one kind on one graph. ``known`` tells who serves a name on the network now."""

    def __init__(
        self, kind: str, graph: str, gateway_id: str, known: Callable[[str], ServiceInfo | ActionInfo | None]
    ) -> None:
        self._kind, self._graph, self._gateway_id, self._known = kind, graph, gateway_id, known
        self._entries: dict[str, list[Claim[P]]] = {}
        self._locks: dict[str, asyncio.Lock] = {}
        self._warned: set[str] = set()
        self._changed: asyncio.Future[None] | None = None

    def holder(self, name: str) -> Claim[P] | None:
        """Return the claim that serves ``name`` in this process."""
        for entry in self._entries.get(name, ()):
            if entry.serving:
                return entry
        return None

    def providers(self, name: str) -> list[P]:
        """Return everything that wants to serve ``name``, first come first."""
        return [entry.provider for entry in self._entries.get(name, ())]

    def changed(self) -> asyncio.Future[None]:
        """Return what is done at the next change; all who wait share it."""
        if self._changed is None:
            self._changed = asyncio.get_running_loop().create_future()
        return self._changed

    def names(self) -> Sequence[str]:
        """Return every name that is wanted here."""
        return list(self._entries)

    async def add(self, entry: Claim[P]) -> None:
        """Serve, or wait in line. Raises what the graph raises where the name is free but cannot be served."""
        self._entries.setdefault(entry.name, []).append(entry)
        try:
            await self.settle(entry.name, raising=True)
        except BaseException:
            self._drop(entry)
            raise

    async def remove(self, entry: Claim[P]) -> None:
        """Release a claim; the next in line takes over."""
        if entry.closed:
            return
        entry.closed = True
        self._drop(entry)
        await entry.suspend()
        await self.settle(entry.name)

    def _drop(self, entry: Claim[P]) -> None:
        entries = self._entries.get(entry.name, [])
        if entry in entries:
            entries.remove(entry)
        if not entries:
            self._entries.pop(entry.name, None)
            self._locks.pop(entry.name, None)
            self._warned.discard(entry.name)

    async def settle(self, name: str, *, raising: bool = False) -> None:
        """Let the right one serve ``name``, now that something has changed."""
        if name not in self._entries:
            self._ring()
            return
        async with self._locks.setdefault(name, asyncio.Lock()):
            entries = [e for e in self._entries.get(name, ()) if not e.closed]
            if not entries:
                return
            holder = next((e for e in entries if e.serving), None)
            before = self._before(name, holder)
            if before is not None:
                if holder is not None:
                    log.warning("%s: %s %s is served by %s; this gateway waits", self._graph, self._kind, name, before)
                    await holder.suspend()
                for entry in entries:
                    entry.report(str(before))
            else:
                if holder is None:
                    holder = entries[0]
                    await self._take_over(holder, raising=raising)
                for entry in entries:
                    entry.report("" if entry is holder else holder.user)
        self._ring()

    async def _take_over(self, entry: Claim[P], *, raising: bool) -> None:
        waited = entry.taken_by
        try:
            await entry.resume()
        except RopewayError as error:
            if raising:
                raise
            log.warning("%s: %s %s cannot be served: %s", self._graph, self._kind, entry.name, error)
        else:
            if waited:
                log.info("%s: %s now serves %s %s", self._graph, entry.user, self._kind, entry.name)
            if entry.closed:
                await entry.suspend()

    def _before(self, name: str, holder: Claim[P] | None) -> ProviderInfo | None:
        """Return a provider on the network that takes precedence over ours, or ``None``."""
        info = self._known(name)
        servers: Sequence[ProviderInfo] = info.servers if info is not None else ()
        others = [p for p in servers if not p.local and (not p.gateway or p.gateway != self._gateway_id)]
        if holder is None:
            return others[0] if others else None
        young = time.time_ns() - holder.since_ns < _YIELDS_S * 1e9
        for other in others:
            if other.gateway and other.since_ns:
                if (other.since_ns, other.gateway) < (holder.since_ns, self._gateway_id):
                    return other
            elif young:
                return other
            elif name not in self._warned:
                self._warned.add(name)
                log.warning(
                    "%s: %s %s of %s is served by %s, too; callers may get either",
                    self._graph,
                    self._kind,
                    name,
                    holder.user,
                    other,
                )
        return None

    def _ring(self) -> None:
        changed, self._changed = self._changed, None
        if changed is not None and not changed.done():
            changed.set_result(None)
