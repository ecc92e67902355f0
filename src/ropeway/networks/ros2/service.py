"""A service that we serve through rclpy, which has no raw services: requests and responses are converted here."""

from __future__ import annotations

import asyncio
import logging
from functools import partial
from typing import TYPE_CHECKING, Any, Final, Protocol

from ropeway.errors import CallError
from ropeway.graph.base import Undelivered
from ropeway.graph.calls import Request, ServiceHandler
from ropeway.networks.ros2.host import Ros2Host
from ropeway.tasks import Chores

if TYPE_CHECKING:
    from ropeway.networks.ros2.senders import Lane

__all__ = ["Ros2Service"]

log = logging.getLogger("ropeway.ros2")

_RUNNING_LIMIT: Final = 1024
_WAITING_BYTES: Final = 256 << 20
_BURST: Final = 64
_SHORTEST: Final = 4
_TEXTS: Final = (("success", "message"), ("successful", "reason"))


class Ros2ServiceHost(Ros2Host, Protocol):
    """The services of a graph for the services that it serves."""

    async def remove(self, part: Ros2Service, raw: Any, lane: Lane) -> None:
        """Remove a closed service."""
        ...


class Ros2Service:
    """Serves ``service`` with ``handler``, each request in a task of its own.

    ROS 2 has no errors of services: a request that fails is answered with the default response, in which ``message``
    or ``reason`` says why where the type has them beside ``success`` or ``successful``.
    """

    def __init__(
        self, graph: Ros2ServiceHost, service: str, type: str, handler: ServiceHandler, raw: Any, cls: Any
    ) -> None:
        self.service, self.type = service, type
        self.raw = raw
        self.closed = False
        self._graph = graph
        self._handler = handler
        self._class = cls
        self._participant = graph.participant
        self._lane = self._participant.senders.lane(2 * _RUNNING_LIMIT, _WAITING_BYTES, self._on_backlog)
        self._loop = asyncio.get_running_loop()
        self._serving = Chores()
        self._overloaded = False

    # In threads -------------------------------------------------------------------------------------------------

    def take(self) -> None:
        """Take requests; the spinner holds the handle."""
        from rclpy.serialization import serialize_message

        handle = self.raw.handle
        batch: list[tuple[bytes, Any]] = []
        while len(batch) < _BURST:
            request, header = handle.service_take_request(self._class.Request)
            if header is None:
                break
            batch.append((bytes(serialize_message(request)), header))
        if batch:
            self._participant.spinner.push(self.on_requests, batch)

    def _send(self, response: bytes | None, text: str, header: Any) -> None:
        from rclpy.serialization import deserialize_message

        problem = ""
        try:
            if response is not None:
                try:
                    message = deserialize_message(response, self._class.Response)
                except (RuntimeError, ValueError) as error:
                    problem = f"its response cannot be read: {error}"
                    message = self._failure(problem)
            else:
                message = self._failure(text)
            with self.raw.handle:
                self.raw.handle.service_send_response(message, getattr(header, "request_id", header))
        except self._participant.invalid_handle:
            return  # closed meanwhile
        except RuntimeError as error:
            problem = f"an answer was not sent: {error}"
        if problem:
            self._participant.spinner.push(self._on_problem, [problem])

    def _failure(self, text: str) -> Any:
        response = self._class.Response()
        for flag, message in _TEXTS:
            if getattr(response, flag, None) is False and getattr(response, message, None) == "":
                setattr(response, message, text)
        return response

    # On the loop ------------------------------------------------------------------------------------------------

    def on_requests(self, batch: list[tuple[bytes, Any]]) -> None:
        """Take the requests of clients."""
        for payload, header in batch:
            if self.closed:
                return
            if len(self._serving.tasks) >= _RUNNING_LIMIT:
                self._refuse(header)
                continue
            self._serving.start(self._serve(payload, header), f"serve {self.service}")

    def _refuse(self, header: Any) -> None:
        text = f"{_RUNNING_LIMIT} requests of {self.service} are under way, which is the limit"
        self._graph.drops[self.service, Undelivered.BACKLOG] += 1
        if not self._overloaded:
            self._overloaded = True
            log.warning("%s: %s; more are answered with empty responses", self._graph.name, text)
        self._lane.put(partial(self._send, None, text, header))

    async def _serve(self, payload: bytes, header: Any) -> None:
        response, text = None, ""
        try:
            answer = bytes(await self._handler(Request(payload)))
            response = self._graph.border.outgoing(f"{self.type}_Response", answer)
            if len(response) < _SHORTEST:
                text = f"the response has {len(response)} bytes"
                response = None
                self._graph.drops[self.service, Undelivered.ENCODE] += 1
                log.warning("%s: %s: %s", self._graph.name, self.service, text)
        except CallError as error:
            text = str(error)
            log.warning("%s: %s: answered with an empty response: %s", self._graph.name, self.service, text)
        except Exception as error:  # a handler is somebody else's code; its failure is this call's
            text = str(error) or type(error).__name__
            self._graph.drops[self.service, Undelivered.CALLBACK] += 1
            log.exception("%s: the handler of %s failed", self._graph.name, self.service)
        self._lane.put(partial(self._send, response, text, header), len(response or b""))

    def _on_problem(self, batch: list[str]) -> None:
        for problem in batch:
            self._graph.drops[self.service, Undelivered.WRITE] += 1
            log.warning("%s: %s: %s", self._graph.name, self.service, problem)

    def _on_backlog(self, count: int) -> None:
        self._graph.drops[self.service, Undelivered.BACKLOG] += count

    async def close(self) -> None:
        """See ``Service``: those who wait learn it from our leaving."""
        if self.closed:
            return
        self.closed = True
        await self._serving.close()
        await self._graph.remove(self, self.raw, self._lane)
