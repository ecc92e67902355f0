"""A service of others that we call through rclpy."""

from __future__ import annotations

import asyncio
import logging
import threading
from functools import partial
from typing import TYPE_CHECKING, Any, Final, Protocol

from ropeway import aio
from ropeway.errors import CallError, CallFailed, CallTimeout, GraphUnavailable, NotServed, ProviderLost
from ropeway.graph.calls import DEFAULT_TIMEOUT_S, Request
from ropeway.graph.parts import ClientBase
from ropeway.networks.dds.in_flight import InFlightRequests
from ropeway.networks.ros2.host import Ros2Host

if TYPE_CHECKING:
    from ropeway.networks.ros2.senders import Lane

__all__ = ["Ros2Client"]

log = logging.getLogger("ropeway.ros2")

_CALLS_LIMIT: Final = 16_384
_WAITING_BYTES: Final = 256 << 20
_DISCOVERY_S: Final = 3.0  # a server that is there is found so long after the client was made
_NOBODY_S: Final = 0.5  # later on, a server that comes just now is waited for so long
_GRACE_S: Final = 0.1  # an answer that is on its way when its server leaves may arrive so much later
_SETTLE_S: Final = 0.2  # we match a server a little before it matches us, and what it gets before that is lost
_DEFERRED: Final = "/_action/get_result"


class _Call:
    """A call under way, and how it ended."""

    __slots__ = ("forgotten", "outcome", "seq")

    def __init__(self, loop: asyncio.AbstractEventLoop) -> None:
        self.outcome: asyncio.Future[bytes | CallError | GraphUnavailable] = loop.create_future()
        self.seq = 0
        self.forgotten = False

    def finish(self, outcome: bytes | CallError | GraphUnavailable) -> None:
        if not self.outcome.done():
            self.outcome.set_result(outcome)


class Ros2ClientHost(Ros2Host, Protocol):
    """The services of a graph for its clients."""

    async def remove(self, part: Ros2Client, raw: Any, lane: Lane) -> None:
        """Remove a closed client."""
        ...


class Ros2Client(ClientBase[Ros2ClientHost]):
    """Calls ``service``: any number of calls at a time."""

    def __init__(self, graph: Ros2ClientHost, service: str, type: str, raw: Any, cls: Any) -> None:
        super().__init__(graph, service, type)
        self.raw = raw
        self._class = cls
        self._participant = graph.participant
        self._lane = self._participant.senders.lane(_CALLS_LIMIT, _WAITING_BYTES, lambda _: None)
        self._loop = asyncio.get_running_loop()
        self._made = self._loop.time()
        self._calls: dict[_Call, None] = {}
        self._pending: dict[int, _Call] = {}  # by sequence number, also from threads
        self._lock = threading.Lock()
        self._waiting = 0
        self._window = InFlightRequests(deferred=service.endswith(_DEFERRED))
        self._losing: asyncio.TimerHandle | None = None
        self._served_since: float | None = None

    # On the loop ------------------------------------------------------------------------------------------------

    @property
    def available(self) -> bool:
        """Whether a provider serves it now."""
        if self.closed:
            return False
        try:
            with self.raw.handle:
                return bool(self.raw.handle.service_server_is_available())
        except RuntimeError:
            return False

    async def wait_available(self, timeout_s: float) -> bool:
        """See ``Client``."""
        return await self._served(self._loop.time() + timeout_s)

    async def _served(self, until: float) -> bool:
        return await super().wait_available(until - self._loop.time()) and self._look()

    def _look(self) -> bool:
        """See whether it is served, and since when."""
        served = self.available
        if not served:
            self._served_since = None
        elif self._served_since is None:
            self._served_since = self._loop.time()
        return served

    async def _settle(self, until: float) -> None:
        """Wait until a server that was matched just now will have matched us, too, within half of the time."""
        now = self._loop.time()
        fresh_s = (self._served_since or now) + _SETTLE_S - now
        if fresh_s > 0:
            await asyncio.sleep(min(fresh_s, (until - now) / 2))

    async def call(self, request: Request, timeout_s: float = DEFAULT_TIMEOUT_S) -> bytes:
        """See ``Client``. A payload that is no request of this type fails the call."""
        self._check_open()
        if self._waiting >= _CALLS_LIMIT:
            raise CallFailed(self.service, f"{self._waiting} calls of {self.service} are under way, which is the limit")
        self._waiting += 1
        call = _Call(self._loop)
        self._calls[call] = None
        try:
            outcome = await self._ask(call, request, self._loop.time() + timeout_s)
        except TimeoutError:
            raise CallTimeout(self.service, timeout_s) from None
        finally:
            self._waiting -= 1
            self._calls.pop(call, None)
            with self._lock:
                call.forgotten = True
                self._pending.pop(call.seq, None)
        if isinstance(outcome, bytes):
            return outcome
        raise outcome

    async def _ask(self, call: _Call, request: Request, until: float) -> bytes | CallError | GraphUnavailable:
        now = self._loop.time()
        if not await self._served(min(until, max(self._made + _DISCOVERY_S, now + _NOBODY_S))):
            self._check_open()
            raise NotServed(self.service)
        await self._settle(until)
        async with aio.timeout_at(until):
            ticket = await self._window.enter()
            try:
                self._check_open()
                payload = self._graph.border.outgoing(f"{self.type}_Request", bytes(request.payload))
                self._lane.put(partial(self._send, call, payload), len(payload))
                return await call.outcome
            finally:
                self._window.leave(ticket, answered=call.outcome.done() and not call.outcome.cancelled())

    def look(self) -> None:
        """See whether the service is served."""
        if self._look():
            self.changed.notify()
        elif self._calls and self._losing is None:
            self._losing = self._loop.call_later(_GRACE_S, self._lose)

    def _lose(self) -> None:
        self._losing = None
        if self.available or self.closed:
            return
        with self._lock:
            sent = list(self._pending.values())
        for call in sent:
            call.finish(ProviderLost(self.service, "its server has left"))

    def _on_answers(self, batch: list[tuple[_Call, bytes | CallError | GraphUnavailable]]) -> None:
        for call, outcome in batch:
            call.finish(outcome)

    # In threads -------------------------------------------------------------------------------------------------

    def _send(self, call: _Call, payload: bytes) -> None:
        from rclpy.serialization import deserialize_message

        failure: CallError | GraphUnavailable
        try:
            request = deserialize_message(payload, self._class.Request)
            with self.raw.handle, self._lock:  # no answer is looked for before its number is known
                if call.forgotten:
                    return
                call.seq = self.raw.handle.send_request(request)
                self._pending[call.seq] = call
            return
        except self._participant.invalid_handle:
            failure = self._closed_in_mid_call()
        except (RuntimeError, ValueError) as error:
            failure = CallFailed(self.service, f"the request cannot be sent: {error}")
        self._participant.spinner.push(self._on_answers, [(call, failure)])

    def take(self) -> None:
        """Take responses; the spinner holds the handle."""
        from rclpy.serialization import serialize_message

        batch: list[tuple[_Call, Any]] = []
        while True:
            header, response = self.raw.handle.take_response(self._class.Response)
            if header is None:
                break
            number = getattr(header, "request_id", header).sequence_number
            with self._lock:
                call = self._pending.pop(number, None)
            if call is None:
                log.debug("%s: %s: answer %d came late", self._graph.name, self.service, number)
            else:
                batch.append((call, bytes(serialize_message(response))))
        if batch:
            self._participant.spinner.push(self._on_answers, batch)

    async def close(self) -> None:
        """See ``Client``."""
        if self.closed:
            return
        self.closed = True
        self.changed.notify()
        if self._losing is not None:
            self._losing.cancel()
        for call in list(self._calls):
            call.finish(self._closed_in_mid_call())
        self._window.close()
        await self._graph.remove(self, self.raw, self._lane)
