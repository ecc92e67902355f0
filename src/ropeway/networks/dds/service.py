"""A service that we serve over DDS, in the mapping of rmw_cyclonedds."""

from __future__ import annotations

import asyncio
import hashlib
import logging
from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import Final

from ropeway import aio
from ropeway.errors import CallError, GraphError, TypesError
from ropeway.graph.base import Sample, Undelivered
from ropeway.graph.begun import BeginningHandler, Begun, Ended
from ropeway.graph.calls import Request, Service, ServiceHandler
from ropeway.logs import failed
from ropeway.networks.dds.answer_pacing import AnswerPacing
from ropeway.networks.dds.matching import paired
from ropeway.networks.dds.records import MatchedEndpoint
from ropeway.networks.dds.rpc import HEADER_BYTES, RequestHeader, join, split
from ropeway.networks.dds.service_endpoints import LITTLE_ENDIAN, DdsCallHost, Ends
from ropeway.networks.dds.vendors import HEADER_VENDOR, vendor_name
from ropeway.tasks import Chores

__all__ = ["DdsService"]

log = logging.getLogger("ropeway.dds")

_RUNNING_LIMIT: Final = 1024
_SEEN_LIMIT: Final = 8192  # requests that are known as such; more than can be under way
_MATCH_S: Final = 1.0  # how long an answer waits for its reader
_SEND_S: Final = 5.0  # how long an answer waits for room on the network
_RETRY_S: Final = 0.005
_SHORTEST_BYTES: Final = 4  # of CDR: its header
_QUIET_S: Final = 60.0
_TEXTS: Final = (("success", "message"), ("successful", "reason"))


class DdsService(Ends):
    """Serves ``service`` with ``handler``, each request once: in a task of its own, unless it can begin at once.

    ROS 2 has no errors of services: a request that fails is answered with the default response, in which ``message``
    or ``reason`` says why where the type has them beside ``success`` or ``successful``.
    """

    serves = True

    def __init__(self, graph: DdsCallHost, service: str, type: str, handler: ServiceHandler) -> None:
        super().__init__(graph, service, type)
        self._request_type, self._response_type = f"{self.type}_Request", f"{self.type}_Response"
        self.ignored = 0  # requests of another mapping, which the graph's helper serves where there is one
        self._handler = handler
        self._begins = handler.begin if isinstance(handler, BeginningHandler) else None
        self._begun: set[Begun] = set()
        self._helped: Service | None = None
        self._serving = Chores()
        self._seen: dict[tuple[bytes, RequestHeader], None] = {}
        self._callers: dict[bytes, MatchedEndpoint] = {}
        self._paces: dict[bytes, AnswerPacing] = {}
        self._warned: dict[str, float] = {}

    async def get_help(self) -> None:
        """Have the graph's helper serve those of another mapping; where it cannot, the others are served alone.

        To be called before ``join``: so those do not take our endpoints for what they can call.
        """
        if self._graph.helper is None:
            return
        try:
            self._helped = await self._graph.helper.create_service(self.service, self.type, self.answer)
        except GraphError as error:
            log.warning("%s: %s serves nodes of Cyclone DDS only: %s", self._graph.name, self.service, error)

    async def end_help(self) -> None:
        """End the help of the graph's helper."""
        if self._helped is not None:
            await self._helped.close()

    # From DDS ---------------------------------------------------------------------------------------------------

    def on_samples(self, batch: Sequence[Sample]) -> None:
        """Take the requests of clients, on the loop."""
        if self.closed:
            return
        for sample in batch:
            if not sample.origin.startswith(HEADER_VENDOR):
                self._ignore(sample.origin)
                continue
            message = split(sample.payload)
            if message is None:
                self._graph.drops[self.service, Undelivered.DECODE] += 1
                log.debug("%s: %s: %d bytes are not a request", self._graph.name, self.service, len(sample.payload))
                continue
            self._take(sample.origin, message.header, message.payload)

    def on_match(self) -> None:
        """Take the current list of matched clients."""
        self._callers = paired(self._writers, self._readers)
        self._paces = {guid: pace for guid, pace in self._paces.items() if guid in self._callers or not pace.idle}

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

    def _take(self, writer: bytes, header: RequestHeader, payload: bytes) -> None:
        key = (writer, header)
        if key in self._seen:
            log.debug("%s: %s: request %d came twice", self._graph.name, self.service, header.seq)
            return
        if len(self._serving.tasks) + len(self._begun) >= _RUNNING_LIMIT:
            self._graph.drops[self.service, Undelivered.BACKLOG] += 1
            self._warn("%s requests are under way; more are dropped", _RUNNING_LIMIT)
            return
        self._seen[key] = None
        if len(self._seen) > _SEEN_LIMIT:
            del self._seen[next(iter(self._seen))]
        pace = self._paces.get(writer)
        if pace is None:
            pace = self._paces[writer] = AnswerPacing()
        pace.came()
        if self._begins is None or not self._begin(writer, header, payload, pace, self._begins):
            self._serving.start(self._serve(writer, header, payload, pace), f"serve {self.service}")

    def _warn(self, text: str, value: object) -> None:
        """Say so in the log, each kind of trouble once a minute; the counts are in ``drops``."""
        now = self._loop.time()
        if now - self._warned.get(text, float("-inf")) < _QUIET_S:
            level = logging.DEBUG
        else:
            level, self._warned[text] = logging.WARNING, now
        log.log(level, "%s: %s: %s", self._graph.name, self.service, text % value)

    # Serving ----------------------------------------------------------------------------------------------------

    def _begin(
        self,
        writer: bytes,
        header: RequestHeader,
        payload: bytes,
        pace: AnswerPacing,
        begins: Callable[[Request, Ended], Begun | None],
    ) -> bool:
        """Begin to serve a request now; return false, having done nothing, where that takes a task."""
        if payload[1] != LITTLE_ENDIAN:
            return False
        try:
            payload = self._graph.layouts.read("client", self.service, self._request_type, payload, writer)
        except TypesError:
            return False

        def over(how: bytes | BaseException) -> None:
            self._begun.discard(call)
            if not self.closed and not self._answer_at_once(writer, header, how, pace):
                self._serving.start(self._conclude(writer, header, how, pace), f"serve {self.service}")
            else:
                self._went(writer, pace)

        begun = begins(Request(payload, _call_id(writer, header), (), self._graph.node_of(writer)), over)
        if begun is None:
            return False
        call = begun
        self._begun.add(call)
        return True

    def _answer_at_once(
        self, writer: bytes, header: RequestHeader, how: bytes | BaseException, pace: AnswerPacing
    ) -> bool:
        caller = self._callers.get(writer)
        if caller is None or not isinstance(how, bytes) or len(how) < _SHORTEST_BYTES:
            return False
        try:
            response = self._graph.layouts.write("client", self.service, self._response_type, how, writer)
        except TypesError:
            return False
        if not self._writer.sends_at_once(len(response) + HEADER_BYTES) or not (caller.ours or pace.may_go()):
            return False
        return self._writer.send_at_once(join(header, response)) is None

    def _went(self, writer: bytes, pace: AnswerPacing) -> None:
        if pace.went() and writer not in self._callers:
            self._paces.pop(writer, None)

    async def _conclude(
        self, writer: bytes, header: RequestHeader, how: bytes | BaseException, pace: AnswerPacing
    ) -> None:
        """Answer a request that was begun, with what came of it."""
        try:
            response = self._response(how)
            response = self._graph.layouts.write("client", self.service, self._response_type, response, writer)
            await self._send(writer, header, response, pace)
        except TypesError as error:
            self._unanswerable(error)
        finally:
            self._went(writer, pace)

    def _unanswerable(self, error: TypesError) -> None:
        self._graph.drops[self.service, Undelivered.ENCODE] += 1
        self._warn("a request fails and cannot be answered: %s", error)

    async def _serve(self, writer: bytes, header: RequestHeader, payload: bytes, pace: AnswerPacing) -> None:
        try:
            if payload[1] != LITTLE_ENDIAN:
                try:
                    payload = self._graph.little_endian(self._request_type, payload)
                except TypesError as error:
                    self._graph.drops[self.service, Undelivered.DECODE] += 1
                    self._warn("a request cannot be read: %s", error)
                    return
            request = Request(payload, _call_id(writer, header), (), self._graph.node_of(writer))
            try:
                response = await self.answer(request, writer)
            except TypesError as error:
                self._unanswerable(error)
            else:
                await self._send(writer, header, response, pace)
        finally:
            self._went(writer, pace)

    async def _send(self, writer: bytes, header: RequestHeader, response: bytes, pace: AnswerPacing) -> None:
        """Send an answer once the one who asked reads answers, and has taken those before."""
        if writer in self._callers or await self._matched(writer):
            if not self._callers[writer].ours:
                await pace.turn()
            message = join(header, response)
            if (not_sent := await self._writer.send(message)) is not None:
                await self._send_again(message, not_sent)

    async def _matched(self, writer: bytes) -> bool:
        """Wait until the one who asked reads answers; false for one that does not, or has left."""
        try:
            async with aio.timeout(_MATCH_S):
                while writer not in self._callers:
                    await self._changed.wait()
        except TimeoutError:
            if any(peer.guid == writer for peer in self._writers):
                self._graph.drops[self.service, Undelivered.WRITE] += 1
                self._warn("a client that asks reads no answers: %s", writer.hex())
            return False  # who has left needs none
        return True

    async def answer(self, request: Request, writer: bytes | None = None) -> bytes:
        """Return the handler's answer, or the default response with its error, both in the client's layout.

        The handler's failures are logged and counted here. Raises ``UnknownType`` where the default is not known,
        ``ValueMismatch`` where the other layout cannot hold the response.
        """
        layouts, name = self._graph.layouts, self.service
        payload = layouts.read("client", name, self._request_type, request.payload, writer)
        if payload is not request.payload:
            request = replace(request, payload=payload)
        how: bytes | BaseException
        try:
            how = bytes(await self._handler(request))
        except Exception as error:  # a handler is somebody else's code; its failure is this call's
            how = error
        return layouts.write("client", name, self._response_type, self._response(how), writer)

    def _response(self, how: bytes | BaseException) -> bytes:
        """Return what a request is answered with, of which this came."""
        if isinstance(how, bytes):
            if len(how) >= _SHORTEST_BYTES:
                return how
            self._graph.drops[self.service, Undelivered.ENCODE] += 1
            return self._failure(f"a response of {len(how)} bytes is not CDR", logged=True)
        if isinstance(how, CallError):
            return self._failure(str(how), logged=True)
        self._graph.drops[self.service, Undelivered.CALLBACK] += 1
        failed(log, "%s: the handler of %s failed", self._graph.name, self.service, error=how)
        return self._failure(str(how) or type(how).__name__)

    def _failure(self, text: str, *, logged: bool = False) -> bytes:
        """Return the default response, with ``text`` where the type has a place for it."""
        if logged:
            self._warn("answered with an empty response: %s", text)
        codec = self._graph.registry.codec(self._response_type)
        response = codec.default()
        for flag, message in _TEXTS:
            if response.get(flag) is False and response.get(message) == "":
                response[message] = text
        return codec.encode(response)

    async def _send_again(self, message: bytes, reason: Undelivered | None) -> None:
        """Send an answer that was not sent for some ``reason``, once that is possible."""
        until = self._loop.time() + _SEND_S
        while reason is not None:
            if reason is not Undelivered.WRITE or self._loop.time() >= until:
                self._graph.drops[self.service, reason] += 1
                self._warn("an answer was not sent: %s", reason.value)
                return
            await asyncio.sleep(_RETRY_S)
            reason = await self._writer.send(message)

    async def close(self) -> None:
        """See ``Service``: those who wait learn it from our leaving."""
        if self.closed:
            return
        self.closed = True
        await self.end_help()
        for call in list(self._begun):
            call.give_up()
        await self._serving.close()
        await self._graph.remove(self)


def _call_id(writer: bytes, header: RequestHeader) -> bytes:
    """Derive the id of a call: the same for every gateway, so that a call taken by two gateways runs once
    behind them.
    """
    return hashlib.blake2b(join(header, writer), digest_size=16).digest()
