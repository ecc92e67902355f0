"""Streams the values of the store over HTTP, one line of JSON each, as long as the client may and does read."""

from __future__ import annotations

import asyncio
import json
from collections.abc import Callable
from fnmatch import fnmatchcase
from typing import Any, Final, cast

from ropeway.errors import TypesError
from ropeway.limits import WATCHER_SILENCE_S, WATCHER_UNREAD_BYTES
from ropeway.listener.authorization import Access
from ropeway.listener.http import HttpRequest
from ropeway.listener.listener import keep_alive
from ropeway.store import CDR, Entry, Key, Store, as_json
from ropeway.types import TypeRegistry

__all__ = ["StoreWatcher", "entry_json"]

_HEAD: Final = (
    b"HTTP/1.1 200 OK\r\nContent-Type: application/x-ndjson\r\nCache-Control: no-store\r\n"
    b"X-Content-Type-Options: nosniff\r\nConnection: close\r\n"
)


def entry_json(entry: Entry, registry: TypeRegistry) -> dict[str, Any]:
    """Return a value as JSON for people and programs; a ROS message stands under ``message``, if its type is known."""
    found = as_json(entry, age_s=round(entry.age_s(), 3))
    if entry.form == CDR:
        try:
            found["message"] = json.loads(registry.codec(entry.type).json(entry.data))
        except TypesError:
            return found
        found.pop("base64", None)
    return found


class StoreWatcher(asyncio.Protocol):
    """Sends every value as a line, those that are there first.

    ``on_begin`` and ``on_end`` are called when it begins and when it is over. Who does not read is given up: when it is
    too far behind, or has taken nothing for too long. Whether a silent one is still there is asked by TCP.
    """

    def __init__(self, store: Store, registry: TypeRegistry, access: Access, system: str, topic: str) -> None:
        self.access = access
        self.request: HttpRequest | None = None
        self.on_begin: Callable[[StoreWatcher], None] = _nothing
        self.on_end: Callable[[StoreWatcher], None] = _nothing
        self._store, self._registry = store, registry
        self._system, self._topic = system, topic
        self._transport: asyncio.Transport | None = None
        self._patience: asyncio.TimerHandle | None = None

    def connection_made(self, transport: asyncio.BaseTransport) -> None:
        """Begin to send values."""
        self._transport = cast(asyncio.Transport, transport)
        self._transport.set_write_buffer_limits(high=0)
        keep_alive(self._transport)
        self.on_begin(self)
        origin = self.request.headers.get("origin", "") if self.request is not None else ""
        readable = f"Access-Control-Allow-Origin: {origin}\r\nVary: Origin\r\n" if origin else ""
        self._transport.write(_HEAD + readable.encode("latin-1") + b"\r\n")
        self._store.on_change.append(self._changed)
        for entry in self._store.entries(self._system, self._topic):
            self._changed(entry)

    def data_received(self, data: bytes) -> None:
        """Ignore data: the head comes again, and nothing else matters."""

    def pause_writing(self) -> None:
        """Start the patience timer: the client reads slower than values come."""
        if self._patience is None:
            self._patience = asyncio.get_running_loop().call_later(WATCHER_SILENCE_S, self.end)

    def resume_writing(self) -> None:
        """Stop the patience timer: the client has read everything."""
        if self._patience is not None:
            self._patience.cancel()
            self._patience = None

    def connection_lost(self, exc: Exception | None) -> None:
        """Stop following the store: the client has left."""
        self.resume_writing()
        if self._transport is None:
            return
        self._transport = None
        if self._changed in self._store.on_change:
            self._store.on_change.remove(self._changed)
        self.on_end(self)

    def end(self) -> None:
        """End it now: what waits is not sent."""
        if self._transport is not None:
            self._transport.abort()

    def _changed(self, change: Entry | Key) -> None:
        transport = self._transport
        if transport is None or transport.is_closing():
            return
        system, topic = change.key if isinstance(change, Entry) else change
        if not (fnmatchcase(system, self._system) and fnmatchcase(topic, self._topic)):
            return
        if not self.access.allows("subscribe", f"/{system}/{topic}"):
            return
        if isinstance(change, Entry):
            value = entry_json(change, self._registry)
        else:
            value = {"system": system, "topic": topic, "removed": True}
        transport.write(json.dumps(value).encode() + b"\n")
        if transport.get_write_buffer_size() > WATCHER_UNREAD_BYTES:
            transport.abort()


def _nothing(watcher: StoreWatcher) -> None:
    """Do nothing: no callback was set."""
