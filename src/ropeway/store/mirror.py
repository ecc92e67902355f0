"""Synchronises a store with a database elsewhere: the later value of either is copied to the other.

Values are kept in the store first, and copied whenever the database answers. Changes that others make there (other
servers, or programs that know nothing of versions) are followed, and a value that is not in the store is looked up
there.
"""

from __future__ import annotations

import asyncio
import contextlib
import logging
import time
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from typing import TYPE_CHECKING, Any, Final, Protocol

from ropeway import aio
from ropeway.errors import StoreUnavailable, ValueRefused
from ropeway.store.entry import FOREIGN, Backend, Entry, Key, SharedBackend
from ropeway.store.thread import run_in
from ropeway.tasks import Supervised, end

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping

__all__ = ["Mirroring"]

log = logging.getLogger("ropeway.store")

_RETRY_S: Final = (0.25, 10.0)  # first and longest pause before a mirror is tried again
_BATCH: Final = 500
_MISS_S: Final = 1.0  # a value that is not there is not looked for again so soon; changes are followed anyway
_MISSES: Final = 1024
_LOOK_S: Final = 3.0  # who asks for a value waits no longer for the mirror
_NOT_YET: Final = "not connected yet"


class Mirrored(Protocol):
    """Describes what a mirror needs of the store whose values it keeps."""

    @property
    def backend(self) -> Backend:
        """The backend that the store itself writes to."""
        ...

    def get(self, system: str, topic: str) -> Entry | None:
        """Return a value that is here."""
        ...

    def entries(self) -> list[Entry]:
        """Return all values that are here."""
        ...

    def waiting(self, key: Key) -> Entry | None:
        """Return the value that is not written yet."""
        ...

    def put(self, entry: Entry) -> bool:
        """Take a value. Raises ``ValueRefused``."""
        ...

    async def remove(self, system: str, topic: str, *, mirrored: bool) -> bool:
        """Forget a value. Raises ``StoreUnavailable``."""
        ...


class Mirroring:
    """The work of one ``mirror`` for ``store``."""

    def __init__(self, store: Mirrored, mirror: SharedBackend, *, history: int) -> None:
        self.mirror = mirror
        self.fault = _NOT_YET
        self._store, self._history = store, history
        self._owed: dict[Key, list[Entry]] = {}
        self._removals: dict[Key, None] = {}
        self._adopted: dict[Key, tuple[int, str]] = {}  # what came from there need not go there
        self._misses: dict[Key, float] = {}
        self._wake = asyncio.Event()
        self._connected = False
        self._writer = ThreadPoolExecutor(1, thread_name_prefix="store mirror")
        self._reader = ThreadPoolExecutor(2, thread_name_prefix="store mirror reads")
        self._tasks: list[Supervised] = []

    def start(self) -> None:
        """Start the mirroring."""
        self._tasks = [Supervised(self._run, "store mirror").start(), Supervised(self._follow, "store follows").start()]

    async def close(self) -> None:
        """End, and let go of the mirror."""
        await end(*self._tasks)
        await self._in(self._writer, self.mirror.close)
        for thread in (self._writer, self._reader):
            thread.shutdown(wait=False)

    def status(self) -> dict[str, Any]:
        """Return how it stands, as JSON."""
        waiting = len(self._owed) + len(self._removals)
        return {"url": self.mirror.url, "waiting": waiting, "fault": self.fault, "follows": self.mirror.follows}

    # ── what the store tells ───────────────────────────────────────────────────────────────────────────────────

    def owe(self, entries: Mapping[Key, list[Entry]]) -> None:
        """Bring values over that were kept here."""
        most = self._history + 1
        for key, more in entries.items():
            own = [entry for entry in more if entry.order != self._adopted.get(key)]
            if own:
                owed = self._owed.setdefault(key, [])
                owed.extend(own)
                owed.sort(key=lambda entry: entry.order)
                del owed[:-most]
        self._wake.set()

    def forget(self, key: Key) -> None:
        """Remove a topic there, too."""
        self._owed.pop(key, None)
        self._removals[key] = None
        self._wake.set()

    # ── looking further ────────────────────────────────────────────────────────────────────────────────────────

    def may_find(self, key: Key) -> bool:
        """Return whether it is worth while to look a value up that is not here."""
        missed = self._misses.get(key)
        return self._connected and key not in self._removals and (missed is None or time.monotonic() - missed > _MISS_S)

    async def find(self, key: Key) -> bool:
        """Look a value up, and take it over; return whether the mirror knows its system."""
        read_ns = time.time_ns()
        try:
            async with aio.timeout(_LOOK_S):
                found, knows_system = await self._in(self._reader, self.mirror.find, key)
        except (StoreUnavailable, TimeoutError) as error:
            log.debug("%s: %s/%s was not looked up: %s", self.mirror.url, *key, error)
            return False
        if found is not None:
            self._adopt(found, read_ns, live=True)
        else:
            self._misses[key] = time.monotonic()
            if len(self._misses) > _MISSES:
                del self._misses[next(iter(self._misses))]
        return bool(knows_system)

    # ── the work ───────────────────────────────────────────────────────────────────────────────────────────────

    async def _run(self) -> None:
        pause = _RETRY_S[0]
        self._connected = False
        while True:
            try:
                if not self._connected:
                    await self._in(self._writer, self.mirror.open)
                    read_ns = time.time_ns()
                    self._merge(await self._in(self._writer, self.mirror.load), read_ns)
                    self._connected = True
                    log.info("%s: connected, %d values to bring over", self.mirror.url, len(self._owed))
                await self._bring_over()
                self.fault, pause = "", _RETRY_S[0]
                await self._wake.wait()
                self._wake.clear()
                if not self._connected:
                    raise StoreUnavailable(self.mirror.url, "cannot be followed")
            except StoreUnavailable as error:
                if self._connected or self.fault in ("", _NOT_YET):
                    log.warning("%s; values are kept in %s until it is back", error, self._store.backend.url)
                self.fault, self._connected = str(error), False
                await asyncio.sleep(pause)
                pause = min(2 * pause, _RETRY_S[1])

    async def _follow(self) -> None:
        while True:
            if self._connected:
                try:
                    changes = await self._in(self._reader, self.mirror.changes)
                except StoreUnavailable:
                    self._connected = False
                    self._wake.set()  # it is opened again
                else:
                    for entry in changes.entries:
                        self._adopt(entry, changes.read_ns, live=True)
                    for key in changes.gone:
                        await self._gone(key, changes.read_ns)
            await asyncio.sleep(self.mirror.pause_s)

    def _merge(self, theirs: list[Entry], read_ns: int) -> None:
        """Take what is later there, and owe what is later here."""
        known = {entry.key: entry for entry in theirs}
        for entry in theirs:
            self._adopt(entry, read_ns, live=False)
        for entry in self._store.entries():
            other = known.get(entry.key)
            missing = other is None or (other.order < entry.order and other.data != entry.data)
            if missing and self._adopted.get(entry.key) != entry.order:
                self.owe({entry.key: [entry]})

    def _adopt(self, entry: Entry, read_ns: int, *, live: bool) -> None:
        """Take a value over that is in the mirror. One without a version, or with that of another, is new as of now.

        ``live`` tells that it was seen to change; else a value of a node here is taken for the later one.
        """
        key, store = entry.key, self._store
        if self._is_on_its_way(key):
            return  # what is here is later
        self._misses.pop(key, None)
        known = store.get(*key)
        if known is not None and entry.order <= known.order:
            if (entry.data, entry.type, entry.form) == (known.data, known.type, known.form):
                return
            foreign = not entry.version or entry.order == known.order
            later = known.version >= read_ns // 1000
            if not foreign or later or not (live or known.origin == entry.origin):
                self._adopted.pop(key, None)
                self.owe({key: [known]})
                return
            entry = replace(entry, version=read_ns // 1000, stamp_ns=read_ns, origin=FOREIGN)
        elif not entry.version:
            entry = entry.at(read_ns // 1000)
        self._adopted[key] = entry.order
        with contextlib.suppress(ValueRefused):  # counted there
            store.put(entry)

    def _is_on_its_way(self, key: Key) -> bool:
        """Return whether what nodes here said or removed is not in the mirror yet."""
        waiting = self._store.waiting(key)
        own = waiting is not None and waiting.order != self._adopted.get(key)
        return own or key in self._owed or key in self._removals

    async def _gone(self, key: Key, read_ns: int) -> None:
        known = self._store.get(*key)
        if known is None or self._is_on_its_way(key) or known.version >= read_ns // 1000:
            return
        self._adopted.pop(key, None)
        with contextlib.suppress(StoreUnavailable):  # it is gone from memory; a restart may find it on the disk again
            await self._store.remove(*key, mirrored=False)

    async def _bring_over(self) -> None:
        if self._removals:
            keys = list(self._removals)
            await self._in(self._writer, self.mirror.remove, keys)
            for key in keys:
                self._removals.pop(key, None)
                self._adopted.pop(key, None)
        while self._owed:
            keys = list(self._owed)[:_BATCH]
            taken = {key: list(self._owed[key]) for key in keys}
            batch = [entry for entries in taken.values() for entry in entries]
            await self._in(self._writer, self.mirror.write, batch, self._history)
            for key, entries in taken.items():
                left = [entry for entry in self._owed.get(key, ()) if entry not in entries]
                if left:
                    self._owed[key] = left
                else:
                    self._owed.pop(key, None)

    async def _in(self, thread: ThreadPoolExecutor, work: Callable[..., Any], *args: Any) -> Any:
        return await run_in(thread, self.mirror.url, work, *args)
