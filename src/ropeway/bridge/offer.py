"""Offers on one graph what is served on another, while it is served there.

Services and actions share this: the name appears on the second graph when the first has a provider, and is withdrawn
with it, so that clients that wait for a service see its true state. If the first graph cannot tell who serves what, the
name is offered while the graph is up.
"""

from __future__ import annotations

import asyncio
import contextlib
import logging
from bisect import bisect_left
from collections import Counter
from typing import Any, ClassVar, Final, Protocol

from ropeway import aio
from ropeway.bridge.options import AS_IT_COMES, BridgeOptions
from ropeway.bridge.upkeep import Upkeep
from ropeway.delivery.histogram import BOUNDS_S, Histogram
from ropeway.graph.base import Graph
from ropeway.graph.link_parts import Contended, is_encoded

__all__ = ["Offer"]

log = logging.getLogger("ropeway.bridge")

_LOOK_S: Final = 1.0  # graphs tell most changes at once; the state of a link without discovery is looked at so often


class _User(Protocol):
    @property
    def available(self) -> bool | None: ...

    async def close(self) -> None: ...


class _Server(Protocol):
    async def close(self) -> None: ...


class Offer:
    """A name served on ``source`` as ``source_name``, offered on ``target`` as ``target_name``.

    ``counts``: requests by how they ended (``answered``, or the name of the error).
    """

    kind: ClassVar[str] = ""
    default_timeout_s: ClassVar[float | None] = None

    def __init__(
        self,
        source: Graph,
        target: Graph,
        source_name: str,
        target_name: str,
        type: str,
        options: BridgeOptions = AS_IT_COMES,
    ) -> None:
        self.source, self.target = source, target
        self.witness = options.witness
        self.source_name, self.target_name, self.type = source_name, target_name, type
        self.timeout_s, self.delivery = options.timeout_s or self.default_timeout_s, options.delivery
        self.taken_by = ""
        self.counts: Counter[str] = Counter()
        self.under_way = 0
        self._ended: asyncio.Event | None = None  # where somebody waits for the end of requests
        self.took_s: float | None = None  # the last one, smoothed
        self.durations = Histogram()
        self._client: Any = None
        self._server: _Server | None = None
        label = f"{self.kind} {source_name} to {target.name}"
        self._upkeep = Upkeep(self._set_right, source, self.kind, source_name, label=label, look_s=_LOOK_S)

    async def make_client(self) -> Any:
        """Create the user of the name on the source."""
        raise NotImplementedError

    async def make_server(self) -> Any:
        """Create the provider of the name on the target."""
        raise NotImplementedError

    async def start(self) -> None:
        """Bring the bridge up; what fails now is tried again until it works."""
        self._upkeep.start()

    async def finish(self, limit_s: float) -> None:
        """Let the requests that are under way end, for ``limit_s`` at most; ``close`` is to follow."""
        ended = self._ended = asyncio.Event()
        with contextlib.suppress(TimeoutError):
            async with aio.timeout(limit_s):
                while self.under_way:
                    ended.clear()
                    await ended.wait()

    async def close(self) -> None:
        """Withdraw the name, and stop using its provider."""
        await self._upkeep.close()
        await self._withdraw()
        client, self._client = self._client, None
        if client is not None:
            await client.close()

    @property
    def error(self) -> str:
        """The reason why the name cannot be offered, ``""`` if it can."""
        return self._upkeep.error

    @property
    def state(self) -> str:
        """The state in one word: ``active``, ``waiting`` (nobody serves it), ``taken`` (another provider offers it) or
        ``failed``.
        """
        if self.error:
            return "failed"
        if self.taken_by:
            return "taken"
        return "active" if self._server is not None else "waiting"

    @property
    def encoding(self) -> str:
        """The encoding of requests and answers if the side that a link leads to can tell, otherwise the
        configured one.
        """
        parts = (self._server, self._client)
        return next((part.encoding for part in parts if is_encoded(part)), self.delivery.encoding)

    def done(self, how: str, took_s: float) -> None:
        """Count a request that has ended."""
        self.counts[how] += 1
        if self._ended is not None:
            self._ended.set()
        durations = self.durations
        (durations.counts or durations.begun())[bisect_left(BOUNDS_S, took_s)] += 1
        durations.sum_ns += round(took_s * 1e9)
        self.took_s = took_s if self.took_s is None else self.took_s + 0.2 * (took_s - self.took_s)

    async def _set_right(self) -> None:
        if self._client is None:
            self._client = await self.make_client()
        wanted = self._client.available is not False
        if wanted and self._server is None:
            server = self._server = await self.make_server()
            if isinstance(server, Contended):
                server.on_state(self._taken)
            log.info("%s %s of %s is offered on %s", self.kind, self.target_name, self.source.name, self.target.name)
        elif not wanted and self._server is not None:
            await self._withdraw()
            log.info("%s %s is no longer offered on %s", self.kind, self.target_name, self.target.name)

    def _taken(self, taken_by: str) -> None:
        if taken_by and taken_by != self.taken_by:
            log.warning(
                "%s %s is already offered on %s by %s; this route takes over when that leaves",
                self.kind,
                self.target_name,
                self.target.name,
                taken_by,
            )
        self.taken_by = taken_by

    async def _withdraw(self) -> None:
        server, self._server = self._server, None
        self.taken_by = ""
        if server is not None:
            await server.close()
            await self.withdrawn()

    async def withdrawn(self) -> None:
        """Clean up after the name was withdrawn from the target."""
