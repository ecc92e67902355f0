"""Fast DDS as the ``dds`` graph uses it: nothing happens until there is somebody to help."""

from __future__ import annotations

import asyncio
import logging
from collections.abc import Iterable
from typing import Final

from ropeway.errors import CallFailed, GraphUnavailable
from ropeway.graph.calls import ServiceHandler
from ropeway.networks.dds.endpoint_qos import user_data
from ropeway.networks.dds.fastdds.identity import FAST
from ropeway.networks.dds.fastdds.rpc import FastClient, FastRpc, FastService
from ropeway.networks.dds.names import dds_service_topics, dds_type
from ropeway.networks.dds.participant import DdsParticipant
from ropeway.networks.dds.raw import DdsError
from ropeway.networks.dds.raw_endpoints import RawReader
from ropeway.networks.dds.records import Discovered, Joined
from ropeway.networks.dds.vendors import HELPER_MARK
from ropeway.qos import QoS
from ropeway.tasks import background, end

__all__ = ["FastHelper", "PendingService"]

_WEIGHT_QOS: Final = QoS(depth=1)

log = logging.getLogger("ropeway.dds")


class FastHelper:
    """The ``VendorHelper`` for Fast DDS nodes. It starts ``rpc`` when one of them is served or called."""

    def __init__(self, rpc: FastRpc, participant: DdsParticipant) -> None:
        self._rpc, self._participant = rpc, participant
        self._known = False
        self._starting: asyncio.Task[bool] | None = None
        self._services: dict[PendingService, None] = {}

    def on_discovered(self, batch: Iterable[Discovered]) -> None:
        """Check endpoints that were discovered for Fast DDS nodes."""
        if not self._known and any(isinstance(item, Joined) and item.participant.startswith(FAST) for item in batch):
            self._known = True
            if self._services:
                self.wake()

    def wake(self) -> None:
        """Start the helper in advance: a call is expected."""
        if self._starting is None:
            self._starting = background(self._start(), f"{self._rpc.graph}: start of Fast DDS")

    async def _start(self) -> bool:
        started = await self._rpc.start()
        for service in list(self._services):
            if started:
                try:
                    await service.open()
                except Exception:  # of one service; the others are served
                    log.exception("%s: %s is not served to Fast DDS nodes", self._rpc.graph, service.service)
        return started

    async def create_client(self, service: str, type: str) -> FastClient:
        """See ``VendorHelper``. Raises ``CallFailed`` where Fast DDS nodes cannot be called."""
        self.wake()
        assert self._starting is not None
        if not await asyncio.shield(self._starting):
            raise CallFailed(
                service,
                f"{service} is served over Fast DDS only, whose requests cannot be made here ({self._rpc.reason}); "
                "run the server with RMW_IMPLEMENTATION=rmw_cyclonedds_cpp, or use the ros2 graph",
            )
        return await self._rpc.create_client(service, type)

    async def create_service(self, service: str, type: str, handler: ServiceHandler) -> PendingService:
        """See ``VendorHelper``. Gives at once what begins to serve with the first Fast DDS node."""
        pending = PendingService(self, service, type, handler, self._weigh(service, type))
        self._services[pending] = None
        if self._rpc.available:
            await pending.open()
        elif self._known:
            self.wake()
        return pending

    async def serve(self, pending: PendingService) -> FastService:
        """Make the endpoint of a service."""
        return await self._rpc.create_service(pending.service, pending.type, pending.handler)

    async def forget(self, pending: PendingService) -> None:
        """Release what belongs to a closed service."""
        self._services.pop(pending, None)
        if pending.weight is not None:
            await self._participant.delete(pending.weight)

    def _weigh(self, service: str, type: str) -> RawReader | None:
        """Make one reader more than our side of the service has writers; the helper process adds the missing writer.

        Fast DDS nodes take a service for available when they see as many readers of requests as writers of replies.
        So they wait for those that they can use, instead of calling those that ``DdsService`` makes for others.
        """
        request, _ = dds_service_topics(service)
        mark = user_data(gateway_id=self._rpc.gateway_id, extra=f"{HELPER_MARK}=1;")
        try:
            return self._participant.create_reader(
                (request, dds_type(type, "_Request")), type, _WEIGHT_QOS, mark, _ignore, _ignore, silent=True
            )
        except DdsError as error:
            log.warning("%s: %s: Fast DDS nodes may call it too early: %s", self._rpc.graph, service, error)
            return None

    async def close(self) -> None:
        """End the helper process."""
        starting, self._starting = self._starting, None
        await end(starting)
        await self._rpc.close()


class PendingService:
    """A service for Fast DDS nodes, from when there are any."""

    def __init__(
        self, helper: FastHelper, service: str, type: str, handler: ServiceHandler, weight: RawReader | None
    ) -> None:
        self.service, self.type, self.handler, self.weight = service, type, handler, weight
        self._helper = helper
        self._served: FastService | None = None
        self._closed = False

    async def open(self) -> None:
        """Begin to serve."""
        if self._closed or self._served is not None:
            return
        try:
            self._served = await self._helper.serve(self)
        except GraphUnavailable as error:
            log.debug("%s is not served to Fast DDS nodes: %s", self.service, error)

    async def close(self) -> None:
        """See ``Service``."""
        if not self._closed:
            self._closed = True
            if self._served is not None:
                await self._served.close()
            await self._helper.forget(self)


def _ignore(_: object) -> None:
    """Ignore what a silent reader receives, which is nothing."""
