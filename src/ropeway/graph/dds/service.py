"""A service that we serve over DDS, in the mapping of rmw_cyclonedds."""

from __future__ import annotations

import asyncio
import hashlib
import logging
from collections import deque
from collections.abc import Sequence
from typing import TYPE_CHECKING, Final

from ropeway.errors import CallError, TypesError
from ropeway.graph.base import Sample, Undelivered
from ropeway.graph.calls import Request, Service, ServiceHandler
from ropeway.graph.dds.ends import Ends
from ropeway.graph.dds.matching import paired
from ropeway.graph.dds.records import Peer
from ropeway.graph.dds.rpc import Header, join, split
from ropeway.graph.dds.vendors import speaks_header, vendor_name
from ropeway.tasks import end

if TYPE_CHECKING:
    from ropeway.graph.dds.graph import DdsGraph

__all__ = ["DdsService"]

log = logging.getLogger("ropeway.graph.dds")

_RUNNING_LIMIT: Final = 1024
_SEEN_LIMIT: Final = 8192  # requests that are known as such; more than can be under way
_MATCH_S: Final = 1.0  # how long an answer waits for its reader
_SEND_S: Final = 5.0  # how long an answer waits for room on the network
_RETRY_S: Final = 0.005
# Nodes of ROS 2 keep ten answers, everybody's, until they get round to taking theirs.
_BURST: Final = 5
_PACE_S: Final = 0.0005
_DEEP: Final = 100
_TEXTS: Final = (("success", "message"), ("successful", "reason"))


class DdsService(Ends):
    """Serves ``service`` with ``handler``, each request in a task of its own, and each request once.

    ROS 2 has no errors of services: a request that fails is answered with the default response, in which ``message``
    or ``reason`` says why where the type has them beside ``success`` or ``successful``.
    """

    serves = True

    def __init__(self, graph: DdsGraph, service: str, type: str, handler: ServiceHandler) -> None:
        super().__init__(graph, service, type)
        self.ignored = 0  # requests of another mapping, which the graph's helper serves where there is one
        self._handler = handler
        self._helped: Service | None = None
        self._tasks: set[asyncio.Task[None]] = set()
        self._seen: dict[tuple[bytes, Header], None] = {}
        self._callers: dict[bytes, Peer] = {}
        self._shallow = False
        self._turns: deque[asyncio.Future[None]] = deque()
        self._turn: asyncio.TimerHandle | None = None
        self._burst = _BURST
        self._burst_at = 0.0
        self._overloaded = False

    async def get_help(self) -> None:
        """Have the graph's helper serve those of another mapping."""
        if self._graph.helper is not None:
            self._helped = await self._graph.helper.create_service(self.service, self.type, self.answer)

    # From DDS ---------------------------------------------------------------------------------------------------

    def on_samples(self, batch: Sequence[Sample]) -> None:
        """What clients ask, on the loop."""
        if self.closed:
            return
        for sample in batch:
            if not speaks_header(sample.origin):
                self._ignore(sample.origin)
                continue
            message = split(sample.payload)
            if message is None:
                self._graph.drops[self.service, Undelivered.DECODE] += 1
                log.debug("%s: %s: %d bytes are no request", self._graph.name, self.service, len(sample.payload))
                continue
            self._take(sample.origin, message.header, message.payload)

    def on_match(self) -> None:
        """Other clients are there now."""
        self._shallow = any(0 < peer.depth < _DEEP for peer in self._readers)
        self._callers = paired(self._writers, self._readers)

    def _ignore(self, writer: bytes) -> None:
        self.ignored += 1
        if self.ignored == 1 and self._helped is None:
            log.warning(
                "%s: %s: %s asks over %s, whose requests this graph cannot answer; run it with "
                "RMW_IMPLEMENTATION=rmw_cyclonedds_cpp, or use the ros2 graph",
                self._graph.name,
                self.service,
                self._graph.node_of(writer) or "a client",
                vendor_name(writer),
            )

    def _take(self, writer: bytes, header: Header, payload: bytes) -> None:
        key = (writer, header)
        if key in self._seen:
            log.debug("%s: %s: request %d came twice", self._graph.name, self.service, header.seq)
            return
        if len(self._tasks) >= _RUNNING_LIMIT:
            self._graph.drops[self.service, Undelivered.BACKLOG] += 1
            if not self._overloaded:
                self._overloaded = True
                log.warning(
                    "%s: %s: %d requests are under way; more are dropped until some are answered",
                    self._graph.name,
                    self.service,
                    _RUNNING_LIMIT,
                )
            return
        self._seen[key] = None
        if len(self._seen) > _SEEN_LIMIT:
            del self._seen[next(iter(self._seen))]
        task = self._loop.create_task(self._serve(writer, header, payload), name=f"serve {self.service}")
        self._tasks.add(task)
        task.add_done_callback(self._done)

    def _done(self, task: asyncio.Task[None]) -> None:
        self._tasks.discard(task)
        if self._overloaded and len(self._tasks) < _RUNNING_LIMIT // 2:
            self._overloaded = False

    # Serving ----------------------------------------------------------------------------------------------------

    async def _serve(self, writer: bytes, header: Header, payload: bytes) -> None:
        try:
            payload = self._graph.little_endian(f"{self.type}_Request", payload)
        except TypesError as error:
            self._graph.drops[self.service, Undelivered.DECODE] += 1
            log.warning("%s: %s: a request cannot be read: %s", self._graph.name, self.service, error)
            return
        request = Request(payload, id=_call_id(writer, header), caller=self._graph.node_of(writer))
        try:
            response = await self.answer(request)
        except TypesError as error:
            self._graph.drops[self.service, Undelivered.ENCODE] += 1
            log.warning("%s: %s: no answer to %s: %s", self._graph.name, self.service, request.caller, error)
            return
        try:
            async with asyncio.timeout(_MATCH_S):
                while writer not in self._callers:
                    await self._changed.wait()
        except TimeoutError:
            if any(peer.guid == writer for peer in self._writers):
                self._graph.drops[self.service, Undelivered.WRITE] += 1
                log.warning("%s: %s: the client that asked reads no answers", self._graph.name, self.service)
            return  # who has left needs none
        await self._wait_turn()
        await self._reply(join(header, response))

    async def answer(self, request: Request) -> bytes:
        """What the handler says, or the default response with its error. Raises ``UnknownType`` where that is unknown.

        The handler's failures are logged and counted here.
        """
        try:
            response = bytes(await self._handler(request))
            if len(response) >= 4:
                return response
            text = f"the response has {len(response)} bytes"
            self._graph.drops[self.service, Undelivered.ENCODE] += 1
            log.warning("%s: %s: %s", self._graph.name, self.service, text)
        except CallError as error:
            text = str(error)
            log.warning("%s: %s: answered with an empty response: %s", self._graph.name, self.service, text)
        except Exception as error:
            text = str(error) or type(error).__name__
            self._graph.drops[self.service, Undelivered.CALLBACK] += 1
            log.exception("%s: the handler of %s failed", self._graph.name, self.service)
        return self._failure(text)

    def _failure(self, text: str) -> bytes:
        codec = self._graph.registry.codec(f"{self.type}_Response")
        response = codec.default()
        for flag, message in _TEXTS:
            if response.get(flag) is False and response.get(message) == "":
                response[message] = text
        return codec.encode(response)

    async def _reply(self, message: bytes) -> None:
        until = self._loop.time() + _SEND_S
        while (reason := await self._writer.send(message)) is not None:
            if reason is not Undelivered.WRITE or self._loop.time() >= until:
                self._graph.drops[self.service, reason] += 1
                log.warning("%s: %s: an answer was not sent: %s", self._graph.name, self.service, reason.value)
                return
            await asyncio.sleep(_RETRY_S)

    async def _wait_turn(self) -> None:
        """Answers to readers that keep few of them go out in small bursts."""
        if not self._shallow:
            return
        now = self._loop.time()
        self._burst = min(_BURST, self._burst + int((now - self._burst_at) / _PACE_S))
        if self._burst > 0 and not self._turns:
            self._burst -= 1
            self._burst_at = now
            return
        turn: asyncio.Future[None] = self._loop.create_future()
        self._turns.append(turn)
        if self._turn is None:
            self._turn = self._loop.call_later(_BURST * _PACE_S, self._next_turns)
        await turn

    def _next_turns(self) -> None:
        self._turn = None
        self._burst, self._burst_at = 0, self._loop.time()
        for _ in range(min(_BURST, len(self._turns))):
            turn = self._turns.popleft()
            if not turn.done():
                turn.set_result(None)
        if self._turns:
            self._turn = self._loop.call_later(_BURST * _PACE_S, self._next_turns)

    async def close(self) -> None:
        """See ``Service``: those who wait learn it from our leaving."""
        if self.closed:
            return
        self.closed = True
        if self._helped is not None:
            await self._helped.close()
        await end(*self._tasks)
        if self._turn is not None:
            self._turn.cancel()
        await self._graph.remove(self)


def _call_id(writer: bytes, header: Header) -> bytes:
    """The same for everyone who serves this request, so that a call taken by two gateways runs once behind them."""
    return hashlib.blake2b(join(header, writer), digest_size=16).digest()
