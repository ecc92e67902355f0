"""Serves last values over HTTP: ``GET /store``, ``GET /store/SYSTEM``, ``GET /store/SYSTEM/TOPIC``, and ``DELETE`` of
one.

``?watch=1`` keeps the connection and sends every later value as a line of JSON; ``?raw=1`` gives the bytes as they
are, ``?history=1`` the values before, too. Names are percent-encoded; whatever stands behind the system is the topic.
"""

from __future__ import annotations

import asyncio
from collections.abc import Callable, Coroutine
from typing import Any, Final, cast
from urllib.parse import unquote

from ropeway.errors import AccessDenied, StoreUnavailable
from ropeway.listener.authorization import Access, Role
from ropeway.listener.http import HttpRequest, Response, reply
from ropeway.listener.store_watcher import StoreWatcher, entry_json
from ropeway.store import Entry, Store, as_json
from ropeway.tasks import background
from ropeway.types import TypeRegistry

__all__ = ["StorePages"]

_ROOT: Final = "/store"


class StorePages:
    """Answers requests below ``/store`` to clients with access."""

    cross_origin_methods: tuple[str, ...] = ()

    def __init__(self, store: Store, registry: TypeRegistry) -> None:
        self.store, self.registry = store, registry

    def knows(self, path: str) -> bool:
        """Return whether ``path`` is one of its paths."""
        return path == _ROOT or path.startswith(f"{_ROOT}/")

    def recheck(self, keeps: Callable[[HttpRequest, Role], bool]) -> None:
        """See ``ClientPages``; watchers are those of the server."""

    def __call__(self, request: HttpRequest, access: Access) -> Response | asyncio.Protocol:
        """Return the answer, or the protocol that continues on the connection."""
        parts = request.path.removeprefix(_ROOT).strip("/").split("/", 1)
        system = unquote(parts[0]) or "*"
        topic = unquote(parts[1]) if len(parts) > 1 and parts[1] else "*"
        flags = {key for key, values in request.query.items() if values[-1] not in ("0", "false", "")}
        if request.method == "DELETE":
            if "*" in (system, topic):
                return reply(400, {"error": "name one topic: DELETE /store/SYSTEM/TOPIC"})
            return self._allowed(access, "publish", system, topic) or _Later(self._remove(system, topic))
        if request.method not in ("GET", "HEAD"):
            return reply(405, {"error": f"{request.method} is not known here"}, Allow="GET, HEAD, DELETE")
        if "watch" in flags and request.method == "GET":
            return StoreWatcher(self.store, self.registry, access, system, topic)
        if topic == "*":
            return self._list(access, system)
        refused = self._allowed(access, "subscribe", system, topic)
        if refused is not None:
            return refused
        if self.store.get(system, topic) is None and self.store.may_find(system, topic):
            return _Later(self._found(system, topic, flags))
        return self._value(system, topic, flags)

    async def _found(self, system: str, topic: str, flags: set[str]) -> Response:
        """Return a value, first looking it up in a database elsewhere."""
        await self.store.find(system, topic)
        answer = self._value(system, topic, flags)
        return await answer.work if isinstance(answer, _Later) else answer

    def _value(self, system: str, topic: str, flags: set[str]) -> Response | _Later:
        entry = self.store.get(system, topic)
        if entry is None:
            what = f"no value of {system}/{topic}" if self.store.has_system(system) else f"no value of {system}"
            return _missing(what)
        if "history" in flags:
            return _Later(self._history(entry))
        if "raw" in flags:
            return Response(200, entry.data, {"Content-Type": "application/octet-stream", **_about(entry)})
        return reply(
            200, entry_json(entry, self.registry), **{k.replace("-", "_"): v for k, v in _about(entry).items()}
        )

    def _allowed(self, access: Access, verb: str, system: str, topic: str) -> Response | None:
        try:
            access.check(verb, f"/{system}/{topic}")
        except AccessDenied as error:
            return reply(403, {"error": str(error)})
        return None

    def _list(self, access: Access, system: str) -> Response:
        found = [
            {key: value for key, value in as_json(entry, age_s=round(entry.age_s(), 3)).items() if key not in _BULK}
            | {"bytes": len(entry.data)}
            for entry in self.store.entries(system, "*")
            if access.allows("subscribe", f"/{entry.system}/{entry.topic}")
        ]
        if not found and system != "*" and not self.store.has_system(system):
            return _missing(f"no value of {system}")
        return reply(200, found)

    async def _remove(self, system: str, topic: str) -> Response:
        try:
            there = await self.store.remove(system, topic)
        except StoreUnavailable as error:
            return reply(503, {"error": str(error)})
        return reply(200, {"removed": True}) if there else _missing(f"no value of {system}/{topic}")

    async def _history(self, entry: Entry) -> Response:
        try:
            before = await self.store.history(entry.system, entry.topic)
        except StoreUnavailable as error:
            return reply(503, {"error": str(error)})
        return reply(200, [entry_json(one, self.registry) for one in (entry, *before)])


_BULK: Final = ("data", "base64")


def _missing(what: str) -> Response:
    return reply(404, {"error": f"{what} is there", "missing": True})


def _about(entry: Entry) -> dict[str, str]:
    return {"X-Age-Seconds": f"{entry.age_s():.3f}", "X-Version": str(entry.version)}


class _Later(asyncio.Protocol):
    """An answer that takes a while."""

    def __init__(self, work: Coroutine[Any, Any, Response]) -> None:
        self.work = work
        self._task: asyncio.Task[None] | None = None

    def connection_made(self, transport: asyncio.BaseTransport) -> None:
        """Begin the work that was asked for."""
        self._task = background(self._answer(cast(asyncio.Transport, transport)), "answer of the store")

    def data_received(self, data: bytes) -> None:
        """Ignore data: the head comes again, and nothing else matters."""

    def connection_lost(self, exc: Exception | None) -> None:
        """Note that the client has left; work that was begun is finished."""

    async def _answer(self, transport: asyncio.Transport) -> None:
        response = await self.work
        if not transport.is_closing():
            transport.write(response.encode())
            transport.close()
