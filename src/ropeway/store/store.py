"""The last-value store: the last value of every topic, in memory to read and on disk to keep.

A value is readable at once and *kept* once the backend has written it; a writer that asked is told then. Values that
arrive while the backend writes are grouped into the next write, so that thousands a second cost a few writes. A backend
that fails is tried again with what it missed, while values are still served from memory.

With a ``mirror`` (a database elsewhere) values are kept in the backend here first, and are brought over as soon as
and whenever the mirror answers; what others wrote there meanwhile is merged by version.
"""

from __future__ import annotations

import asyncio
import contextlib
import logging
import time
from collections import Counter
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from fnmatch import fnmatchcase
from typing import Any, Final, Protocol, TypeVar

from ropeway import aio
from ropeway.errors import StoreUnavailable, ValueRefused
from ropeway.iort import latest_version
from ropeway.store.entry import Backend, Entry, Key, SharedBackend, Versions, check_name
from ropeway.store.mirror import Mirroring
from ropeway.store.thread import run_in
from ropeway.tasks import Supervised, end

__all__ = ["Sink", "Store", "StoreLimits"]

log = logging.getLogger("ropeway.store")

_RETRY_S: Final = (0.25, 10.0)  # first and longest pause before a backend is tried again
_SWEEP_S: Final = 30.0
_GATHER_S: Final = 0.25  # how long values wait for others where nobody waits for them
T = TypeVar("T")


@dataclass(frozen=True, slots=True)
class StoreLimits:
    """Bounds of a store: bytes of one value, values, bytes of all values together.

    ``max_age_s``: older values are forgotten, ``None`` for never. ``history``: how many values before the last are
    kept of each topic.
    """

    max_value_bytes: int = 1 << 20
    max_values: int = 100_000
    max_bytes: int = 1 << 30
    max_age_s: float | None = None
    history: int = 0


class Sink(Protocol):
    """Learns when values have been written."""

    def kept(self, tokens: list[Any], error: StoreUnavailable | None) -> None:
        """Take note that the values of these tokens now survive a crash, or do not (yet) because of ``error``."""


class Store:
    """Keeps last values by system and topic; ``open`` before use, on the event loop that uses it.

    ``on_change`` callbacks get every entry that became the last one, and the key of one that was removed.
    """

    def __init__(
        self,
        backend: Backend,
        *,
        mirror: SharedBackend | None = None,
        limits: StoreLimits | None = None,
        clock_ns: Callable[[], int] = time.time_ns,
    ) -> None:
        self.backend, self._mirror = backend, mirror
        self.mirroring: Mirroring | None = None
        self.limits = limits or StoreLimits()
        self.versions = Versions(clock_ns)
        self.refused: Counter[str] = Counter()
        self.fault = ""  # why the backend does not keep values now
        self.on_change: list[Callable[[Entry | Key], None]] = []
        self._clock_ns = clock_ns
        self._entries: dict[Key, Entry] = {}
        self._bytes = 0
        self._systems: Counter[str] = Counter()
        self._dirty: dict[Key, list[Entry]] = {}
        self._writing: dict[Key, list[Entry]] = {}  # what the backend is writing now
        self._sinks: dict[Sink, list[tuple[Key, Any]]] = {}
        self._wake = asyncio.Event()
        self._asked = asyncio.Event()  # somebody waits until values are kept
        self._idle = asyncio.Event()
        self._idle.set()
        self._tasks: list[Supervised] = []
        self._thread: ThreadPoolExecutor | None = None
        self._open = False

    # ── life ───────────────────────────────────────────────────────────────────────────────────────────────────

    async def open(self) -> None:
        """Read what is kept. Raises ``StoreUnavailable`` if the backend cannot be opened; a mirror may be away."""
        if self._open:
            return
        self._thread = ThreadPoolExecutor(1, thread_name_prefix="store")
        try:
            await self._run(self.backend.open)
            entries = await self._run(self.backend.load)
        except StoreUnavailable:
            self._thread.shutdown()
            raise
        entries = await self._repaired(entries)
        for entry in entries:
            self._insert(entry)
            self.versions.last = max(self.versions.last, entry.version)
        self._open = True
        self._tasks = [
            Supervised(self._commit, "store commits").start(),
            Supervised(self._sweep, "store sweeps").start(),
        ]
        if self._mirror is not None:
            self.mirroring = Mirroring(self, self._mirror, history=self.limits.history)
            self.mirroring.start()

    async def close(self) -> None:
        """Write what is not kept yet (for up to 5 s), and let go."""
        if not self._open:
            return
        self._open = False
        await self.settled()
        if self.mirroring is not None:
            await self.mirroring.close()
        await end(*self._tasks)
        if self._dirty:
            log.error("%s: %d values could not be kept: %s", self.backend.url, len(self._dirty), self.fault)
        await self._run(self.backend.close)
        if self._thread is not None:
            self._thread.shutdown(wait=False)

    # ── values ─────────────────────────────────────────────────────────────────────────────────────────────────

    def get(self, system: str, topic: str) -> Entry | None:
        """Return the last value, ``None`` if there is none (any more)."""
        entry = self._entries.get((system, topic))
        return None if entry is None or self._is_old(entry) else entry

    def has_system(self, system: str) -> bool:
        """Return whether the system has any value."""
        return system in self._systems

    def entries(self, system: str = "*", topic: str = "*") -> list[Entry]:
        """Return the last values whose names match the patterns, sorted by name."""
        if "*" not in system + topic and "?" not in system + topic and "[" not in system + topic:
            entry = self.get(system, topic)
            return [] if entry is None else [entry]
        return sorted(
            (
                entry
                for (one, other), entry in self._entries.items()
                if fnmatchcase(one, system) and fnmatchcase(other, topic) and not self._is_old(entry)
            ),
            key=lambda entry: entry.key,
        )

    def put(self, entry: Entry, sink: Sink | None = None, token: Any = None) -> bool:
        """Make it the last value of its topic; false if it is that already.

        ``sink`` is told with ``token`` once it is kept. Raises ``ValueRefused``: ``too-big``, ``full``, ``name``, or
        ``stale`` where a later value is there (which stays; the older one becomes history where there is any).
        """
        key = (entry.system, entry.topic)
        before = self._entries.get(key)
        if before is None:
            self._check_new(entry)
        elif entry.version <= before.version and entry.order <= before.order:
            if entry.order == before.order:
                if sink is not None:
                    self._promise(sink, key, token)
                return False
            if self.limits.history:
                self._queue(key, entry)
            raise self._refuse(entry, "stale", f"version {before.version} is there, which is later")
        if entry.version > latest_version(self._clock_ns()):
            text = f"version {entry.version} is a time that lies too far in the future; is the writer's clock right?"
            raise self._refuse(entry, "malformed", text)
        size = len(entry.data)
        if size > self.limits.max_value_bytes:
            raise self._refuse(entry, "too-big", f"{size} bytes; a value has {self.limits.max_value_bytes} at most")
        grown = self._bytes + size - (len(before.data) if before is not None else 0)
        if grown > self.limits.max_bytes:
            raise self._refuse(entry, "full", f"all values together have {self.limits.max_bytes} bytes at most")
        if before is None:
            self._systems[entry.system] += 1
        self._entries[key] = entry
        self._bytes = grown
        if entry.version > self.versions.last:
            self.versions.last = entry.version
        self._queue(key, entry)
        if sink is not None:
            self._sinks.setdefault(sink, []).append((key, token))
            self._asked.set()
        for callback in self.on_change:
            callback(entry)
        return True

    def waiting(self, key: Key) -> Entry | None:
        """Return the last value of the topic that is not kept yet."""
        entries = self._dirty.get(key) or self._writing.get(key)
        return entries[-1] if entries else None

    def may_find(self, system: str, topic: str) -> bool:
        """Return whether a value that is not here may be in a database elsewhere, so that ``find`` is worth while."""
        return self.mirroring is not None and self.mirroring.may_find((system, topic))

    async def find(self, system: str, topic: str) -> bool:
        """Look a value up in the database elsewhere, for ``get``; return whether its system is known, here or there."""
        known = self.mirroring is not None and await self.mirroring.find((system, topic))
        return known or self.has_system(system)

    async def remove(self, system: str, topic: str, *, mirrored: bool = True) -> bool:
        """Forget a topic and its history. True if it was there; raises ``StoreUnavailable``.

        ``mirrored`` false leaves it in the database elsewhere.
        """
        key = (system, topic)
        entry = self._entries.pop(key, None)
        self._dirty.pop(key, None)
        if entry is not None:
            self._forget(entry)
        await self._run(self.backend.remove, [key])
        if self.mirroring is not None and mirrored:
            self.mirroring.forget(key)
        return entry is not None

    async def history(self, system: str, topic: str) -> list[Entry]:
        """Return the values before the last one, newest first. Raises ``StoreUnavailable``."""
        await self.settled()
        return await self._run(self.backend.history, (system, topic))

    async def settled(self, timeout_s: float = 5.0) -> bool:
        """Wait until everything is kept; false when the time is over."""
        self._asked.set()
        with contextlib.suppress(TimeoutError):
            async with aio.timeout(timeout_s):
                await self._idle.wait()
                return True
        return False

    def status(self) -> dict[str, Any]:
        """Return the state of the store as JSON."""
        found: dict[str, Any] = {
            "url": self.backend.url,
            "values": len(self._entries),
            "bytes": self._bytes,
            "waiting": len(self._dirty),
            "fault": self.fault,
            "refused": {code: n for code, n in self.refused.items() if n},
        }
        if self.mirroring is not None:
            found["mirror"] = self.mirroring.status()
        return found

    # ── inside ─────────────────────────────────────────────────────────────────────────────────────────────────

    def _is_old(self, entry: Entry) -> bool:
        most = self.limits.max_age_s
        return most is not None and entry.age_s(self._clock_ns()) > most

    async def _repaired(self, entries: list[Entry]) -> list[Entry]:
        """Give values from an impossible future the version of now, in the backend, too: all that follow are later."""
        now_ns = self._clock_ns()
        found = [entry for entry in entries if entry.version > latest_version(now_ns)]
        if not found:
            return entries
        log.warning(
            "%s: %d values were written with a clock far ahead; they count as new", self.backend.url, len(found)
        )
        mended = {entry.key: entry.at(now_ns // 1000) for entry in found}
        await self._run(self.backend.remove, list(mended))
        await self._run(self.backend.write, list(mended.values()), self.limits.history)
        return [mended.get(entry.key, entry) for entry in entries]

    def _check_new(self, entry: Entry) -> None:
        try:
            check_name(entry.system, entry.topic)
        except ValueRefused:
            self.refused["name"] += 1
            raise
        if len(self._entries) >= self.limits.max_values:
            raise self._refuse(entry, "full", f"{self.limits.max_values} values are kept, and no more")

    def _refuse(self, entry: Entry, code: str, reason: str) -> ValueRefused:
        self.refused[code] += 1
        return ValueRefused(entry.system, entry.topic, code, reason)

    def _insert(self, entry: Entry) -> None:
        before = self._entries.get(entry.key)
        if before is None:
            self._systems[entry.system] += 1
        self._entries[entry.key] = entry
        self._bytes += len(entry.data) - (len(before.data) if before is not None else 0)

    def _forget(self, entry: Entry) -> None:
        self._bytes -= len(entry.data)
        self._systems[entry.system] -= 1
        if not self._systems[entry.system]:
            del self._systems[entry.system]
        for callback in self.on_change:
            callback(entry.key)

    def _queue(self, key: Key, entry: Entry) -> None:
        if self.limits.history:
            self._dirty.setdefault(key, []).append(entry)
        else:
            self._dirty[key] = [entry]
        self._idle.clear()
        self._wake.set()

    def _promise(self, sink: Sink, key: Key, token: Any) -> None:
        """Tell when everything that is there now is kept."""
        self._sinks.setdefault(sink, []).append((key, token))
        self._asked.set()
        self._idle.clear()
        self._wake.set()

    async def _run(self, work: Callable[..., T], *args: Any) -> T:
        assert self._thread is not None
        return await run_in(self._thread, self.backend.url, work, *args)

    async def _commit(self) -> None:
        pause = _RETRY_S[0]
        while True:
            await self._wake.wait()
            self._wake.clear()
            with contextlib.suppress(TimeoutError):
                async with aio.timeout(_GATHER_S):
                    await self._asked.wait()
            self._asked.clear()
            if await self._write():
                pause = _RETRY_S[0]
                continue
            await asyncio.sleep(pause)
            pause = min(2 * pause, _RETRY_S[1])
            self._wake.set()

    async def _write(self) -> bool:
        """Write what is not kept; false if the backend could not, and it has to be tried again."""
        dirty, self._dirty = self._dirty, {}
        self._writing = dirty
        sinks, self._sinks = self._sinks, {}
        error: StoreUnavailable | None = None
        bad: dict[Key, str] = {}
        if dirty or self.fault:
            batch = [entry for entries in dirty.values() for entry in entries]
            try:
                bad = await self._run(self.backend.write, batch, self.limits.history)
            except StoreUnavailable as fault:
                error = fault
        self._tell(sinks, error, bad)
        if error is None:
            self._kept(dirty)
            self._writing = {}
            return True
        if str(error) != self.fault:
            log.error("values are not kept: %s", error)
        self.fault = str(error)
        self._restore(dirty)
        self._writing = {}
        return False

    def _kept(self, dirty: dict[Key, list[Entry]]) -> None:
        if self.fault:
            log.info("%s: values are kept again", self.backend.url)
            self.fault = ""
        if self.mirroring is not None and dirty:
            self.mirroring.owe(dirty)
        if not self._dirty and not self._sinks:
            self._idle.set()

    def _restore(self, dirty: dict[Key, list[Entry]]) -> None:
        """Queue what could not be written again, together with what has arrived meanwhile."""
        most = self.limits.history + 1
        for key, entries in dirty.items():
            if key in self._entries:
                self._dirty[key] = [*entries, *self._dirty.get(key, ())][-most:]

    def _tell(
        self, sinks: dict[Sink, list[tuple[Key, Any]]], error: StoreUnavailable | None, bad: dict[Key, str]
    ) -> None:
        for (system, topic), reason in bad.items():
            self.refused["not-kept"] += 1
            log.debug("%s: %s/%s is served, but cannot be kept: %s", self.backend.url, system, topic, reason)
        for sink, promised in sinks.items():
            try:
                sink.kept([token for key, token in promised if key not in bad], error)
                for key, token in promised:
                    if key in bad:
                        sink.kept([token], StoreUnavailable(self.backend.url, bad[key]))
            except Exception:  # of one node; the others are told as ever
                log.exception("a publisher could not be told what was kept")

    async def _sweep(self) -> None:
        most = self.limits.max_age_s
        if most is None:
            return
        while True:
            await asyncio.sleep(min(_SWEEP_S, max(most / 2, 0.05)))
            old = [entry for entry in self._entries.values() if self._is_old(entry)]
            for entry in old:
                with contextlib.suppress(StoreUnavailable):  # the next sweep tries again what is left on the disk
                    await self.remove(entry.system, entry.topic)
