"""Services in the overlay: a call goes sealed to the gateway that serves the name, and to no other."""

from __future__ import annotations

import asyncio
from collections import deque
from collections.abc import Mapping
from functools import partial
from typing import Any, Final, Protocol

from ropeway.errors import (
    CallError,
    CallFailed,
    CallTimeout,
    GoalRejected,
    NotServed,
    ProviderLost,
    SealError,
)
from ropeway.graph.calls import Request, ServiceHandler
from ropeway.graph.local_calls import LEFT, InFlight, answer
from ropeway.graph.parts import ClientBase
from ropeway.limits import OVERLAY_REMEMBERED_BYTES
from ropeway.networks.overlay.advert import Advertisement
from ropeway.networks.overlay.crypto.certificate import Certificate
from ropeway.networks.overlay.graph.host import OverlayHost
from ropeway.networks.overlay.refusal import Refusal
from ropeway.networks.overlay.rpc import RemoteError, part
from ropeway.tasks import end

__all__ = ["OverlayClient", "OverlayService"]

LONGEST_S: Final = 86_400.0
_REMEMBERED: Final = 1024
_AGAIN_S: Final = 0.02
_NO_WAY_S: Final = 3.0  # a link that was cut may come back, or a router be replaced by another


class OverlayCallHost(OverlayHost, Protocol):
    """The services of a graph for its clients and services."""

    lane: int
    nobody_s: float

    def remove_client(self, client: OverlayClient) -> None:
        """Forget a client that was closed."""
        ...

    def remove_service(self, service: OverlayService) -> None:
        """Forget a service that was closed."""
        ...


class OverlayService:
    """A service that we serve in the overlay. A call that comes twice is carried out once."""

    def __init__(self, graph: OverlayCallHost, advert: Advertisement, handler: ServiceHandler) -> None:
        self.service, self.type, self.endpoint = advert.name, advert.type, advert.endpoint
        self.advert = advert
        self.closed = False
        self._graph, self._handler = graph, handler
        self._running = InFlight()
        self._known: dict[bytes, asyncio.Task[bytes] | None] = {}  # ``None``: answered, and its answer forgotten
        self._kept: deque[tuple[bytes, int]] = deque()
        self._kept_bytes = 0

    async def answer_remote(self, caller: Certificate, request: Mapping[str, Any]) -> bytes:
        """Answer a call of another gateway. Raises ``CallError``, or ``SealError`` where it may not call."""
        if not caller.rights.may("call", self.service) or not self._graph.allows("call", self.service, caller):
            raise SealError(Refusal.NO_RIGHT, f"{caller.name} may not call {self.service}")
        if self.closed:
            raise ProviderLost(self.service, LEFT)
        id, timeout_s = part(request, "id", bytes), _timeout_s(request)
        task = self._known.get(id)
        if task is None and id in self._known:
            raise CallFailed(self.service, "this call was answered before")
        if task is None:
            payload, via = part(request, "payload", bytes), part(request, "via", list)
            asked = Request(payload, id, tuple(map(str, via)), part(request, "caller", str), timeout_s)
            work = answer(self.service, self._running, self._handle(asked), timeout_s)
            task = self._known[id] = asyncio.create_task(work, name=f"serve {self.service}")
            task.add_done_callback(partial(self._answered, id))
        return await asyncio.shield(task)

    def _answered(self, id: bytes, task: asyncio.Task[bytes]) -> None:
        """Keep the answer for a call that comes twice; of many answers the oldest are forgotten, so are large ones."""
        if not task.cancelled() and task.exception() is None:
            self._kept.append((id, len(task.result())))
            self._kept_bytes += len(task.result())
        while self._kept_bytes > OVERLAY_REMEMBERED_BYTES or len(self._kept) > _REMEMBERED:
            oldest, size = self._kept.popleft()
            self._kept_bytes -= size
            if oldest in self._known:
                self._known[oldest] = None
        while len(self._known) > _REMEMBERED:
            first = next(iter(self._known))
            known = self._known[first]
            if known is not None and not known.done():
                return
            del self._known[first]

    async def _handle(self, request: Request) -> bytes:
        return bytes(await self._handler(request))

    async def close(self) -> None:
        """See ``Service``."""
        if self.closed:
            return
        self.closed = True
        await self._running.fail(ProviderLost(self.service, LEFT))
        await asyncio.sleep(0)  # who called is told why, before everybody learns that nobody is there
        self._graph.remove_service(self)
        await end(*self._known.values())


def _timeout_s(request: Mapping[str, Any]) -> float:
    value = request.get("timeout")
    if isinstance(value, bool) or not isinstance(value, (int, float)) or not value > 0:
        raise SealError(Refusal.MALFORMED, "a request, whose 'timeout' is not a time")
    return min(float(value), LONGEST_S)


class OverlayClient(ClientBase[OverlayCallHost]):
    """A service that we call in the overlay: of several replicas the one that has served longest, or that of the
    gateway which is the target in our advertisement.
    """

    def __init__(self, graph: OverlayCallHost, advert: Advertisement) -> None:
        super().__init__(graph, advert.name, advert.type)
        self.advert, self.endpoint = advert, advert.endpoint
        self._asking: dict[asyncio.Task[Any], bytes] = {}

    def provider(self) -> Advertisement | None:
        """Return the provider to call."""
        found = self._providers()
        return min(found, key=lambda advert: (advert.since_ns, advert.endpoint), default=None)

    def _providers(self) -> list[Advertisement]:
        found = self._graph.node.rib.by_name(self.advert.global_name, "service")
        return [advert for advert in found if self.advert.target in (b"", advert.gateway)]

    def rematch(self) -> None:
        """React to changed providers: calls to one that has gone fail at once."""
        self.changed.notify()
        there = {advert.endpoint for advert in self._providers()}
        for task, endpoint in list(self._asking.items()):
            if endpoint not in there:
                task.cancel()

    @property
    def available(self) -> bool:
        """Whether a provider serves it now."""
        return not self.closed and self.provider() is not None

    async def _call(self, request: Request, timeout_s: float) -> bytes:
        loop = asyncio.get_running_loop()
        deadline = loop.time() + timeout_s
        if not self.available and not await self.wait_available(min(self._graph.nobody_s, timeout_s)):
            raise NotServed(self.service)
        provider = self.provider()
        assert provider is not None
        task = asyncio.create_task(self._ask(provider, request, deadline), name=f"call {self.service}")
        self._asking[task] = provider.endpoint
        try:
            done, _ = await asyncio.wait({task}, timeout=max(deadline - loop.time(), 0.001))
            if not done:
                raise CallTimeout(self.service, timeout_s)
            if task.cancelled():
                raise ProviderLost(self.service, "its gateway has gone")
            return task.result()
        except RemoteError as error:
            raise _error(self.service, error, timeout_s) from None
        except CallTimeout:
            raise CallTimeout(self.service, timeout_s) from None
        except ProviderLost as error:
            raise ProviderLost(self.service, error.reason) from None
        except SealError as error:
            raise CallFailed(self.service, str(error)) from error
        finally:
            del self._asking[task]
            await end(task)

    async def _ask(self, provider: Advertisement, request: Request, deadline: float) -> bytes:
        """Ask a provider. Where there is no way to it just now, ask again for a while: it carries a call out once."""
        loop = asyncio.get_running_loop()
        pause_s, given_up = _AGAIN_S, 0.0
        while True:
            left_s = max(deadline - loop.time(), 0.001)
            asked = {
                "op": "call",
                "of": provider.endpoint,
                "name": self.service,
                "id": request.id,
                "via": list(request.via),
                "caller": request.caller or self._graph.node.identity.name,
                "timeout": left_s,
                "payload": bytes(request.payload),
            }
            try:
                answer = await self._graph.node.rpc.ask(provider.gateway, asked, left_s, lane=self._graph.lane)
                if type(answer) is not bytes:
                    raise SealError(Refusal.MALFORMED, "an answer")
                return answer
            except ProviderLost:
                given_up = given_up or loop.time() + _NO_WAY_S
                if loop.time() >= given_up:
                    raise
            await asyncio.sleep(pause_s)
            pause_s = min(2 * pause_s, _NO_WAY_S / 8)

    async def _leave(self) -> None:
        self._graph.remove_client(self)


def _error(service: str, error: RemoteError, timeout_s: float) -> CallError:
    if error.word == "NotServed":
        return NotServed(service)
    if error.word == "CallTimeout":
        return CallTimeout(service, timeout_s)
    if error.word == "ProviderLost":
        return ProviderLost(service, error.reason)
    if error.word == "GoalRejected":
        return GoalRejected(service)
    return CallFailed(service, error.text)
