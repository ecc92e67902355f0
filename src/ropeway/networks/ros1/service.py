"""Services that we serve: a connection per caller, who may ask once or again and again."""

from __future__ import annotations

import asyncio
import logging
import struct
from collections import deque
from collections.abc import Sequence
from typing import TYPE_CHECKING, Final

from ropeway.errors import RopewayError, TypesError
from ropeway.graph.base import Undelivered
from ropeway.graph.calls import Request, ServiceHandler
from ropeway.logs import failed
from ropeway.networks.ros1.tcpros import TcprosConnection
from ropeway.tasks import background, describe, end
from ropeway.types.ros1_convert import Converter
from ropeway.types.ros1_types import ANY

if TYPE_CHECKING:
    from ropeway.networks.ros1.node import Ros1Node

__all__ = ["Ros1Service", "ServiceDoor"]

log = logging.getLogger("ropeway.ros1")

_AHEAD_LIMIT: Final = 64  # requests that a caller may send before it has the answers to the first
_CALLERS_LIMIT: Final = 4096
_ANSWER: Final = struct.Struct("<BI")


class _Caller:
    """A connected caller, whose requests are answered in order."""

    def __init__(
        self, door: ServiceDoor, service: Ros1Service, connection: TcprosConnection, name: str, persistent: bool
    ):
        self.connection = connection
        self.service = service
        self._door, self._name, self._persistent = door, name, persistent
        self._waiting: deque[bytes] = deque()
        self._work: asyncio.Task[None] | None = None

    def made(self, connection: TcprosConnection) -> None:
        """See ``tcpros.Receiver``."""

    def header(self, connection: TcprosConnection, fields: dict[str, str]) -> None:
        """See ``tcpros.Receiver``."""

    def writable(self, connection: TcprosConnection) -> None:
        """See ``tcpros.Receiver``."""

    def frames(self, connection: TcprosConnection, frames: Sequence[bytes]) -> None:
        """Take requests; see ``tcpros.Receiver``."""
        self._waiting.extend(frames)
        if len(self._waiting) > _AHEAD_LIMIT:
            connection.abort(f"more than {_AHEAD_LIMIT} requests wait")
        elif self._work is None:
            self._work = background(self._answer_all(), f"calls of {self.service.service}")

    def lost(self, connection: TcprosConnection) -> None:
        """Drop the answers, which nobody waits for any more; see ``tcpros.Receiver``."""
        self._waiting.clear()
        if self._work is not None:
            self._door.late()
            self._work.cancel()
        self._door.callers.discard(self)

    async def _answer_all(self) -> None:
        try:
            while self._waiting:
                good, answer = await self._answer(self._waiting.popleft())
                self.connection.write((_ANSWER.pack(good, len(answer)), answer))
                if not self._persistent:
                    self._waiting.clear()
        except Exception as error:  # nobody shall wait for an answer that does not come
            failed(log, "%s: a call of %s failed", self._door.node.graph.name, self.service.service)
            self.connection.abort(describe(error))
        finally:
            self._work = None
        if not self._persistent:
            self.connection.close()

    async def _answer(self, raw: bytes) -> tuple[bool, bytes]:
        service = self.service
        try:
            payload = service.request.from_ros1(raw)
            response = await service.handler(Request(payload, caller=self._name))
            return True, service.response.to_ros1(bytes(response))
        except TypesError as error:
            log.warning("%s: %s: %s", self._door.node.graph.name, service.service, error)
            return False, str(error).encode()
        except Exception as error:  # a handler is somebody else's code; its failure is this call's
            if not isinstance(error, RopewayError):
                failed(log, "the handler of %s failed", service.service)
            return False, (str(error) or type(error).__name__).encode()

    async def close(self) -> None:
        """Stop answering."""
        work, self._work = self._work, None
        self.connection.abort("the service was closed")
        if work is not asyncio.current_task():
            await end(work)
        await self.connection.closed.wait()


class ServiceDoor:
    """Serves one service name of our node; the first of our services with this name answers."""

    def __init__(self, node: Ros1Node, name: str) -> None:
        self.node, self.name = node, name
        self.ros1_name = ""
        self.registered = False
        self.services: list[Ros1Service] = []
        self.callers: set[_Caller] = set()

    def accept(self, connection: TcprosConnection, fields: dict[str, str]) -> None:
        """Accept a caller, or (``probe``) a peer that asks for the type."""
        service, caller = self.services[0], fields.get("callerid", "")
        ours, asked = service.ros1, fields.get("md5sum", "")
        if asked not in (ANY, ours.md5):
            text = (
                f"client [{caller}] wants service {self.name} to have md5sum {asked}, "
                f"but it has {ours.md5} ({ours.name}). Dropping connection."
            )
            log.warning("%s: %s", self.node.graph.name, text)
            connection.refuse(text)
            return
        if len(self.callers) >= _CALLERS_LIMIT:
            connection.refuse(f"more than {_CALLERS_LIMIT} callers")
            return
        connection.write_header(
            {
                "callerid": self.node.name,
                "md5sum": ours.md5,
                "request_type": f"{ours.name}Request",
                "response_type": f"{ours.name}Response",
                "service": self.name,
                "type": ours.name,
            }
        )
        if fields.get("probe") == "1":
            connection.close()
            return
        made = _Caller(self, service, connection, caller, fields.get("persistent", "").lower() in ("1", "true"))
        connection.receiver = made
        self.callers.add(made)

    def late(self) -> None:
        """Count an answer that nobody waited for."""
        self.node.graph.drops[self.name, Undelivered.LATE] += 1

    async def leave(self, service: Ros1Service) -> None:
        """Remove ``service``; when the last one leaves, the name is unregistered."""
        node = self.node
        self.services.remove(service)
        last = not self.services and node.services.get(self.name) is self
        if last:
            del node.services[self.name]
        for caller in [caller for caller in self.callers if caller.service is service]:
            await caller.close()
        if last and self.registered:
            self.registered = False
            await node.master.leave("unregisterService", self.name, node.service_api)


class Ros1Service:
    """A service served on a ``Ros1Graph``: see ``ropeway.graph.calls.Service``."""

    def __init__(
        self, door: ServiceDoor, type: str, request: Converter, response: Converter, handler: ServiceHandler
    ) -> None:
        self.service, self.type = door.name, type
        self.ros1 = door.node.types.service(type)
        self.request, self.response, self.handler = request, response, handler
        self.closed = False
        self._door = door
        door.services.append(self)
        door.ros1_name = door.services[0].ros1.name

    async def close(self) -> None:
        """Stop serving; calls under way see their connection closed."""
        if not self.closed:
            self.closed = True
            await self._door.leave(self)
