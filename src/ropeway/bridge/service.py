"""Joins a service on two graphs: its provider on the source answers the calls that arrive on the target."""

from __future__ import annotations

import asyncio
from typing import Final

from ropeway.bridge.offer import Offer
from ropeway.errors import CallError, GraphUnavailable, ProviderLost
from ropeway.graph.begun import BeginningClient, Begins, Begun, Ended, Handler
from ropeway.graph.calls import Client, Request, Service

__all__ = ["CALL_TIMEOUT_S", "ServiceBridge"]

CALL_TIMEOUT_S: Final = 60.0
"""How long a call over a route may take unless configured: callers on DDS tell no limit of their own."""


class ServiceBridge(Offer):
    """Offers a service of ``source`` on ``target``: exposed if that is the far side, reserved if it is ours."""

    kind = "service"
    default_timeout_s = CALL_TIMEOUT_S
    _begins: Begins | None = None  # of the client, where it can begin calls at once

    async def make_client(self) -> Client:
        """Create the client of the service on the source."""
        client = await self.source.create_client(self.source_name, self.type, delivery=self.delivery)
        self._begins = client.begin if isinstance(client, BeginningClient) else None
        return client

    async def make_server(self) -> Service:
        """Create the service on the target."""
        return await self.target.create_service(
            self.target_name, self.type, Handler(self.pass_on, self.begin), delivery=self.delivery
        )

    def _limit(self, request: Request) -> float:
        """Return how long a call may take, and have its request say so."""
        assert self.timeout_s is not None
        timeout_s = self.timeout_s if request.timeout_s is None else min(self.timeout_s, request.timeout_s)
        request.timeout_s = timeout_s
        return timeout_s

    def begin(self, request: Request, ended: Ended) -> Begun | None:
        """See ``BeginningHandler``."""
        begins = self._begins
        if begins is None:
            return None
        clock = asyncio.get_running_loop().time
        began = clock()

        def over(how: bytes | BaseException) -> None:
            self.under_way -= 1
            known = isinstance(how, (CallError, GraphUnavailable))
            word = "answered" if isinstance(how, bytes) else type(how).__name__ if known else "given up"
            self.done(word, clock() - began)
            ended(ProviderLost(self.target_name, how.reason) if isinstance(how, GraphUnavailable) else how)

        call = begins(request, self._limit(request), over)
        if call is not None:
            self.under_way += 1
            if self.witness is not None:
                self.witness(request.payload, request.caller)
        return call

    async def pass_on(self, request: Request) -> bytes:
        """Answer a request; see ``ServiceHandler``."""
        timeout_s = self._limit(request)
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
