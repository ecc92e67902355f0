"""Services of Fast DDS nodes, from the gateway's side: clients and services whose endpoints live in the helper."""

from __future__ import annotations

import asyncio
import hashlib
import itertools
import logging
import math
import struct
from collections.abc import Callable, Iterable
from dataclasses import dataclass
from typing import Final

from ropeway import aio
from ropeway.errors import (
    CallError,
    CallFailed,
    CallTimeout,
    GraphUnavailable,
    NotServed,
    ProviderLost,
    TypesError,
)
from ropeway.graph.base import Undelivered
from ropeway.graph.calls import DEFAULT_TIMEOUT_S, Request, ServiceHandler
from ropeway.logs import failed
from ropeway.networks.dds.answer_pacing import AnswerPacing
from ropeway.networks.dds.fastdds.frames import MAX_BODY_BYTES, HelperFrame, Op, Spec
from ropeway.networks.dds.fastdds.process import HelperProcess, Unfit
from ropeway.networks.dds.in_flight import InFlightRequests
from ropeway.networks.dds.profile import Profile
from ropeway.tasks import Chores

__all__ = ["FastClient", "FastRpc", "FastService", "Surroundings"]

log = logging.getLogger("ropeway.dds")

_NOBODY_S: Final = 1.0
_FRESH_S: Final = 4.0  # Fast DDS may take that long to find a participant that is new
_RUNNING_LIMIT: Final = 1024
_CALLS_LIMIT: Final = 16_384
_DEFERRED: Final = "/_action/get_result"
_LOST: Final = "the helper process for Fast DDS has ended"
_request_head = struct.Struct("<16sq")


@dataclass(frozen=True, slots=True)
class Surroundings:
    """Gives access to what the gateway's own side of the graph knows and keeps.

    ``little_endian(type, payload)`` turns what big-endian machines send, and may raise ``TypesError``; ``type_hash``
    gives ``RIHS01_…`` of a type or ``""``; ``node_of(guid)`` names the node of an endpoint; ``drop(service, reason,
    count)`` counts what got lost; ``neighbours()`` gives the GUIDs of the endpoints of Fast DDS nodes, which services
    then wait for, and some time more.
    """

    little_endian: Callable[[str, bytes], bytes] = lambda type, payload: payload
    type_hash: Callable[[str], str] = lambda type: ""
    node_of: Callable[[bytes], str] = lambda guid: ""
    drop: Callable[[str, Undelivered, int], None] = lambda service, reason, count: None
    neighbours: Callable[[], Iterable[bytes]] | None = None


class FastRpc:
    """Calls and serves Fast DDS nodes (rmw_fastrtps_cpp) in domain ``domain``, through a helper process.

    ``graph`` is what messages call it. ``gateway_id`` marks the endpoints as ours. With ``everyone`` it is for nodes of
    other vendors that speak this mapping, too; those of Cyclone DDS, which do not, would get nonsense.
    """

    def __init__(
        self,
        graph: str,
        domain: int,
        profile: Profile,
        *,
        gateway_id: str = "",
        around: Surroundings | None = None,
        everyone: bool = False,
    ) -> None:
        self.graph, self.gateway_id = graph, gateway_id
        self.reason = "it was not started"
        self.around = around or Surroundings()
        self._available = False
        self._closed = False
        self._ends: dict[int, FastClient | FastService] = {}
        self._numbers = itertools.count(1)
        order = {
            "domain": domain,
            "xml": profile.xml,
            "interface": profile.interface,
            "gateway_id": gateway_id,
            "everyone": everyone,
        }
        self.helper = HelperProcess(graph, order, self._on_up, self._on_frame, self._on_down)

    @property
    def available(self) -> bool:
        """Whether the self-test has passed; ``reason`` says why not."""
        return self._available

    async def start(self) -> bool:
        """Start the helper and have it test itself, which takes about a second; tells whether it can be used."""
        try:
            await self.helper.start()
        except Unfit as error:
            self.reason = str(error)
            log.warning(
                "%s: services of Fast DDS nodes (rmw_fastrtps_cpp) cannot be used here: %s. The ros2 graph (rclpy) "
                "can; services of rmw_cyclonedds_cpp and all topics work.",
                self.graph,
                self.reason,
            )
        else:
            self._available, self.reason = True, ""
        return self._available

    async def close(self) -> None:
        """End the helper, with all clients and services."""
        self._closed = True
        await asyncio.gather(*(part.close() for part in list(self._ends.values())))
        self._available, self.reason = False, "it was closed"
        await self.helper.close()

    async def create_client(self, service: str, type: str) -> FastClient:
        """Call ``service`` of ``type``. Raises ``GraphUnavailable``."""
        self._check()
        client = FastClient(self, next(self._numbers), service, type)
        self._add(client, Op.OPEN_CLIENT)
        return client

    async def create_service(self, service: str, type: str, handler: ServiceHandler) -> FastService:
        """Serve ``service`` of ``type``. Raises ``GraphUnavailable``."""
        self._check()
        provider = FastService(self, next(self._numbers), service, type, handler)
        self._add(provider, Op.OPEN_SERVICE)
        return provider

    def remove(self, part: FastClient | FastService) -> None:
        """Remove a closed client or service."""
        if self._ends.pop(part.number, None) is not None:
            self.helper.send(HelperFrame(Op.CLOSE, part.number))

    def send(self, op: Op, part: FastClient | FastService, number: int, body: bytes = b"") -> bool:
        """Tell the helper something about a part; false where that is not possible now."""
        return self.helper.send(HelperFrame(op, part.number, number, body))

    def _check(self) -> None:
        if not self._available:
            raise GraphUnavailable(self.graph, f"services of Fast DDS nodes cannot be used: {self.reason}")

    def _add(self, part: FastClient | FastService, op: Op) -> None:
        self._ends[part.number] = part
        self._open(part, op)

    def _open(self, part: FastClient | FastService, op: Op) -> None:
        hashes = (self.around.type_hash(part.type + half) for half in ("_Request", "_Response"))
        self.helper.send(HelperFrame(op, part.number, body=Spec(part.service, part.type, *hashes).encode()))

    # From the helper --------------------------------------------------------------------------------------------

    def _on_up(self) -> None:
        if self.around.neighbours is not None:
            self.helper.send(HelperFrame(Op.EXPECT, body=b"".join(self.around.neighbours())))
        for part in self._ends.values():
            if isinstance(part, FastClient):
                part.on_up()
            self._open(part, Op.OPEN_CLIENT if isinstance(part, FastClient) else Op.OPEN_SERVICE)

    def _on_down(self) -> None:
        for part in self._ends.values():
            part.on_down()

    def _on_frame(self, frame: HelperFrame) -> None:
        if frame.op == Op.FAULTS:
            text = frame.body.decode(errors="replace")
            log.warning("%s: Fast DDS: %d times could not be done: %s", self.graph, frame.number, text)
            return
        part = self._ends.get(frame.endpoint)
        if part is None:  # it was closed meanwhile
            return
        if frame.op == Op.DROPPED:
            self.around.drop(part.service, Undelivered[frame.body.decode()], frame.number)
        elif frame.op == Op.REFUSED:
            log.warning("%s: %s cannot be made for Fast DDS: %s", self.graph, part.service, frame.body.decode())
        else:
            part.on_frame(frame)


class FastClient:
    """Calls ``service``; see ``Client``. Servers that are no Fast DDS nodes do not count."""

    def __init__(self, rpc: FastRpc, number: int, service: str, type: str) -> None:
        self.service, self.type, self.number = service, type, number
        self.closed = False
        self._rpc = rpc
        self._loop = asyncio.get_running_loop()
        self._window = InFlightRequests(deferred=service.endswith(_DEFERRED))
        self._servers = 0
        self._opened = self._loop.time()
        self._changed = asyncio.Event()
        self._calls: dict[int, asyncio.Future[bytes | CallError | GraphUnavailable]] = {}
        self._numbers = itertools.count(1)
        self._waiting = 0

    @property
    def available(self) -> bool:
        """Whether a Fast DDS node serves it now."""
        return not self.closed and self._servers > 0

    async def wait_available(self, timeout_s: float) -> bool:
        """See ``Client``."""
        try:
            async with aio.timeout(timeout_s):
                while not self.available and not self.closed:
                    await self._changed.wait()
        except TimeoutError:
            pass
        return self.available

    async def call(self, request: Request, timeout_s: float = DEFAULT_TIMEOUT_S) -> bytes:
        """See ``Client``; ``ProviderLost`` also where the helper process ends in mid-call."""
        self._check_open()
        if self._waiting >= _CALLS_LIMIT:
            raise CallFailed(self.service, f"{self._waiting} calls of {self.service} are under way, which is the limit")
        if len(request.payload) > MAX_BODY_BYTES // 2:
            raise CallFailed(self.service, f"a request of {len(request.payload)} bytes is too long for DDS")
        self._waiting += 1
        try:
            until = self._loop.time() + timeout_s
            await self._served(until)
            async with aio.timeout_at(until):
                ticket = await self._window.enter()
            return await self._call(ticket, request.payload, until)
        except TimeoutError:
            raise CallTimeout(self.service, timeout_s) from None
        finally:
            self._waiting -= 1

    async def _served(self, until: float) -> None:
        """Wait for a server: for one second, or as long as a helper that is new may take to find one.

        Raises ``NotServed``, and ``TimeoutError`` where the time is over before that can be said.
        """
        began = self._loop.time()
        while not self.available:
            self._check_open()
            nobody = max(began + _NOBODY_S, self._opened + _FRESH_S) if self._rpc.helper.up else math.inf
            try:
                async with aio.timeout_at(min(nobody, until)):
                    await self._changed.wait()
            except TimeoutError:
                if until < nobody:
                    raise
                raise NotServed(self.service) from None

    async def _call(self, ticket: int, payload: bytes, until: float) -> bytes:
        number = next(self._numbers)
        call = self._calls[number] = self._loop.create_future()
        try:
            self._check_open()
            if not self._rpc.send(Op.CALL, self, number, payload):
                raise ProviderLost(self.service, _LOST)
            async with aio.timeout_at(until):
                outcome = await call
        finally:
            answered = call.done() and not call.cancelled()
            del self._calls[number]
            self._window.leave(ticket, answered=answered)
            if not answered:
                self._rpc.send(Op.FORGET, self, number)
        if isinstance(outcome, bytes):
            try:
                return self._rpc.around.little_endian(f"{self.type}_Response", outcome)
            except TypesError as error:
                raise CallFailed(self.service, f"the answer cannot be read: {error}") from error
        raise outcome

    def _check_open(self) -> None:
        if self.closed:
            raise GraphUnavailable(self._rpc.graph, f"the client of {self.service} is closed")

    def on_frame(self, frame: HelperFrame) -> None:
        """Handle a frame of the helper about this client."""
        if frame.op == Op.MATCHED:
            self._servers = frame.number
            self._tell_changed()
            return
        call = self._calls.get(frame.number)
        if call is None or call.done():
            return
        if frame.op == Op.RESPONSE:
            call.set_result(frame.body)
        elif frame.op == Op.LOST:
            call.set_result(ProviderLost(self.service, frame.body.decode(errors="replace")))
        elif frame.op == Op.FAILED:
            call.set_result(CallFailed(self.service, frame.body.decode(errors="replace")))

    def on_up(self) -> None:
        """Announce this client to the helper, which has started or restarted."""
        self._opened = self._loop.time()
        self._tell_changed()

    def on_down(self) -> None:
        """Fail the calls under way: the helper has ended."""
        self._servers = 0
        self._tell_changed()
        self._finish(ProviderLost(self.service, _LOST))

    def _tell_changed(self) -> None:
        self._changed.set()
        self._changed = asyncio.Event()

    def _finish(self, outcome: CallError | GraphUnavailable) -> None:
        for call in self._calls.values():
            if not call.done():
                call.set_result(outcome)

    async def close(self) -> None:
        """See ``Client``."""
        if self.closed:
            return
        self.closed = True
        self._tell_changed()
        self._finish(GraphUnavailable(self._rpc.graph, f"the client of {self.service} was closed in mid-call"))
        self._window.close()
        self._rpc.remove(self)


class FastService:
    """Serves ``service`` to Fast DDS nodes, and to nobody else; see ``Service``.

    A handler that fails leaves its caller without an answer: the mapping has no errors.
    """

    def __init__(self, rpc: FastRpc, number: int, service: str, type: str, handler: ServiceHandler) -> None:
        self.service, self.type, self.number = service, type, number
        self.closed = False
        self.clients = 0
        self._rpc = rpc
        self._handler = handler
        self._serving = Chores()
        self._paces: dict[bytes, AnswerPacing] = {}

    def on_frame(self, frame: HelperFrame) -> None:
        """Handle a frame of the helper about this service."""
        if frame.op == Op.MATCHED:
            self.clients = frame.number
        elif frame.op == Op.REQUEST and len(self._serving.tasks) >= _RUNNING_LIMIT:
            self._leave_out(frame.number, Undelivered.BACKLOG)
        elif frame.op == Op.REQUEST:
            guid, _ = _request_head.unpack_from(frame.body)
            head, payload = frame.body[: _request_head.size], frame.body[_request_head.size :]
            request = Request(payload, id=_call_id(head), caller=self._rpc.around.node_of(guid))
            self._serving.start(self._serve(frame.number, request, guid), f"serve {self.service}")

    async def _serve(self, number: int, request: Request, caller: bytes) -> None:
        pace = self._paces.setdefault(caller, AnswerPacing())
        pace.came()
        try:
            await self._serve_at(pace, number, request)
        finally:
            pace.went()
            if pace.idle:
                del self._paces[caller]

    async def _serve_at(self, pace: AnswerPacing, number: int, request: Request) -> None:
        life = self._rpc.helper.starts
        try:
            request.payload = self._rpc.around.little_endian(f"{self.type}_Request", request.payload)
            response = await self._handler(request)
        except (CallError, TypesError) as error:
            log.warning("%s: %s: no answer to %s: %s", self._rpc.graph, self.service, request.caller or "a node", error)
            self._leave_out(number, Undelivered.DECODE if isinstance(error, TypesError) else Undelivered.CALLBACK)
        except Exception:  # a handler is somebody else's code; its failure is this call's
            failed(log, "%s: the handler of %s failed", self._rpc.graph, self.service)
            self._leave_out(number, Undelivered.CALLBACK)
        else:
            await pace.turn()
            if life != self._rpc.helper.starts:  # numbers begin again with each helper
                self._rpc.around.drop(self.service, Undelivered.LATE, 1)
            elif len(response) > MAX_BODY_BYTES or not self._rpc.send(Op.REPLY, self, number, response):
                self._leave_out(number, Undelivered.WRITE)

    def _leave_out(self, number: int, reason: Undelivered) -> None:
        self._rpc.around.drop(self.service, reason, 1)
        self._rpc.send(Op.FORGET, self, number)

    def on_down(self) -> None:
        """Drop the requests under way: the helper has ended, so nobody would get the answers."""
        self.clients = 0
        self._serving.cancel()

    async def close(self) -> None:
        """See ``Service``; requests under way are left without an answer."""
        if self.closed:
            return
        self.closed = True
        self._rpc.remove(self)
        await self._serving.close()


def _call_id(identity: bytes) -> bytes:
    """Derive the id of a call: the same for every gateway that serves this request."""
    return hashlib.blake2b(identity, digest_size=16).digest()
