"""Calls services for one viewer; each call is answered exactly once: with a response, or with why there is none."""

from __future__ import annotations

import asyncio
import logging
from functools import partial
from typing import TYPE_CHECKING

from ropeway.errors import CallFailed, InvalidOperation, RopewayError
from ropeway.graph.calls import Request, new_id
from ropeway.hub.kept_clients import KeptClients
from ropeway.limits import CALLS_PER_CLIENT, SHOWN_TEXT_CHARACTERS
from ropeway.networks.foxglove import wire
from ropeway.networks.foxglove.publishing import decoder
from ropeway.tasks import end

if TYPE_CHECKING:
    from collections.abc import Callable

    from ropeway.networks.foxglove.channels import ServiceChannel
    from ropeway.networks.foxglove.host import ViewerHost

__all__ = ["ViewerCalls"]

log = logging.getLogger("ropeway.server")


class ViewerCalls:
    """The calls of a viewer that are under way. ``find`` gives a service that it may call, by its id."""

    def __init__(self, viewer: ViewerHost, find: Callable[[int], ServiceChannel | None], *, timeout_s: float) -> None:
        self._viewer, self._find, self._timeout_s = viewer, find, timeout_s
        self._calls: dict[asyncio.Task[None], wire.ViewerCall] = {}
        self._clients = KeptClients(viewer.view)

    def call(self, op: wire.ViewerCall) -> None:
        """Call a service."""
        viewer = self._viewer
        try:
            if len(self._calls) >= CALLS_PER_CLIENT:
                raise CallFailed("", f"too many calls: {CALLS_PER_CLIENT} of this viewer are under way")
            service = self._find(op.service)
            if service is None:
                raise InvalidOperation("service call", f"there is no service {op.service}")
            viewer.access.check("call_service", service.service)
            request = decoder(viewer, f"{service.type}_Request", op.encoding)
            answer = self._writer(f"{service.type}_Response", op.encoding)
        except RopewayError as error:
            self.refuse(op, error)
            return
        work = self._answer(op, service, request, answer)
        task = asyncio.get_running_loop().create_task(work, name=f"call of {service.service}")
        self._calls[task] = op
        task.add_done_callback(partial(self._ended, op))

    def _writer(self, type: str, encoding: str) -> Callable[[bytes], bytes]:
        codec = self._viewer.writer.codec(type)
        return codec.json if encoding == "json" else codec.raw

    async def _answer(
        self,
        op: wire.ViewerCall,
        service: ServiceChannel,
        read: Callable[[bytes], bytes],
        write: Callable[[bytes], bytes],
    ) -> None:
        viewer = self._viewer
        held = len(op.data)
        viewer.requests_bytes += held
        try:
            request = Request(read(op.data), new_id(), (), viewer.peer_name, self._timeout_s)
            viewer.access.command("call_service", service.service, request.payload)
            client = await self._clients.take(service.service, service.type)
            body = write(await client.call(request, self._timeout_s))
        except (RopewayError, ValueError) as error:
            self.refuse(op, error)
            return
        finally:
            viewer.requests_bytes -= held
        if viewer.sender.crowded(len(body)):
            self.refuse(op, CallFailed(service.service, "answers before this one have not been read"))
            return
        viewer.sender.binary(wire.service_response(op.service, op.call, op.encoding, body))

    def _ended(self, op: wire.ViewerCall, task: asyncio.Task[None]) -> None:
        self._calls.pop(task, None)
        if not task.cancelled() and (error := task.exception()) is not None:
            log.error("%s: a call of a service failed", self._viewer.peer_name, exc_info=error)
            self.refuse(op, CallFailed("", "internal error"))

    def refuse(self, op: wire.ViewerCall, error: Exception) -> None:
        """Answer a call that failed."""
        self._viewer.fault_log.note("service call", "", error)
        text = str(error)[:SHOWN_TEXT_CHARACTERS]
        failure = {"op": "serviceCallFailure", "serviceId": op.service, "callId": op.call, "message": text}
        self._viewer.sender.text(wire.dumps(failure))

    async def give_up(self, reason: str) -> None:
        """Answer the calls that are under way: they fail for this reason."""
        under_way = dict(self._calls)
        await end(*under_way)
        for op in under_way.values():
            self.refuse(op, CallFailed("", reason))

    async def close(self) -> None:
        """Give up what is under way: the viewer is gone."""
        await end(*self._calls)
        await self._clients.close()
