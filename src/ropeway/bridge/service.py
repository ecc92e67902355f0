"""Joins a service on two graphs: its provider on the source answers the calls that arrive on the target."""

from __future__ import annotations

import asyncio
from typing import Final

from ropeway.bridge.offer import Offer
from ropeway.errors import CallError, GraphUnavailable, ProviderLost
from ropeway.graph.calls import Client, Request, Service

__all__ = ["CALL_TIMEOUT_S", "ServiceBridge"]

CALL_TIMEOUT_S: Final = 60.0
"""How long a call over a route may take unless configured: callers on DDS tell no limit of their own."""


class ServiceBridge(Offer):
    """Offers a service of ``source`` on ``target``: exposed if that is the far side, reserved if it is ours."""

    kind = "service"
    default_timeout_s = CALL_TIMEOUT_S

    async def make_client(self) -> Client:
        """Create the client of the service on the source."""
        return await self.source.create_client(self.source_name, self.type, delivery=self.delivery)

    async def make_server(self) -> Service:
        """Create the service on the target."""
        return await self.target.create_service(self.target_name, self.type, self._pass_on, delivery=self.delivery)

    async def _pass_on(self, request: Request) -> bytes:
        assert self.timeout_s is not None
        timeout_s = self.timeout_s if request.timeout_s is None else min(self.timeout_s, request.timeout_s)
        request.timeout_s = timeout_s
        if self.witness is not None:
            self.witness(request.payload, request.caller)
        clock = asyncio.get_running_loop().time
        began, how = clock(), "given up"
        self.under_way += 1
        try:
            response: bytes = await self._client.call(request, timeout_s)
            how = "answered"
        except GraphUnavailable as error:
            how = type(error).__name__
            raise ProviderLost(self.target_name, error.reason) from error
        except CallError as error:
            how = type(error).__name__
            raise
        finally:
            self.under_way -= 1
            self.done(how, clock() - began)
        return response
