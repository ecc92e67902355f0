"""Services that we call. A call under way has a connection of its own; idle ones are kept for the next call."""

from __future__ import annotations

import asyncio
import contextlib
import logging
import struct
from typing import TYPE_CHECKING, Final

from ropeway import aio
from ropeway.errors import (
    CallFailed,
    CallTimeout,
    ConnectFailed,
    InvalidFrame,
    NotServed,
    ProviderLost,
    TypesError,
)
from ropeway.graph.calls import Request
from ropeway.graph.host import Host
from ropeway.graph.parts import ClientBase
from ropeway.networks.ros1.service_probe import Stream, connect
from ropeway.networks.ros1.tcpros import encode_header, read_frame, read_header
from ropeway.networks.ros1.xmlrpc import close_streams

if TYPE_CHECKING:
    from ropeway.networks.ros1.master_registration import MasterRegistration
    from ropeway.networks.ros1.node import Ros1Node
    from ropeway.types.ros1_convert import Converter

__all__ = ["Ros1Client"]

log = logging.getLogger("ropeway.ros1")

_IDLE_LIMIT: Final = 4
_LOOK_AGAIN_S: Final = 0.25


class _Gone(Exception):
    """The provider that was looked up is not there (any more)."""


class Ros1Client(ClientBase[Host]):
    """A service called on a ``Ros1Graph``: see ``ropeway.graph.calls.Client``."""

    def __init__(
        self,
        node: Ros1Node,
        keeper: MasterRegistration,
        service: str,
        type: str,
        request: Converter,
        response: Converter,
    ) -> None:
        super().__init__(node.graph, service, type)
        self.changed = keeper.changed
        self._node, self._keeper = node, keeper
        self._request, self._response = request, response
        self._ros1 = node.types.service(type)
        self._api: str | None = None
        self._providers: list[str] = []  # who served it when it was looked up
        self._looking: asyncio.Lock = asyncio.Lock()
        self._idle: list[Stream] = []

    @property
    def available(self) -> bool:
        """Whether another node serves it, as of the last poll of the master."""
        return not self.closed and self._keeper.picture.served(self.service)

    async def _call(self, request: Request, timeout_s: float) -> bytes:
        reached = [False]
        try:
            async with aio.timeout(timeout_s):
                return await self._reach(request, reached)
        except TimeoutError:
            if reached[0]:
                raise CallTimeout(self.service, timeout_s) from None
            raise NotServed(self.service) from None

    async def _reach(self, request: Request, reached: list[bool]) -> bytes:
        try:
            raw = self._request.to_ros1(request.payload)
        except TypesError as error:
            raise CallFailed(self.service, str(error)) from None
        while True:
            known = self._api is not None
            with contextlib.suppress(_Gone):
                stream = await self._stream()
                reached[0] = True
                return await self._ask(stream, raw)
            self._api = None
            if known:
                continue  # it may have moved
            with contextlib.suppress(TimeoutError):
                async with aio.timeout(_LOOK_AGAIN_S):
                    await self.changed.wait()

    async def _stream(self) -> Stream:
        """Return a connection that has completed its handshake.

        Raises ``_Gone`` where nobody serves it now, ``CallFailed``.
        """
        providers = self._keeper.picture.state.services.get(self.service, [])
        if providers != self._providers:
            self._providers = providers
            self._forget()
        if self._idle:
            for _ in range(2):
                await asyncio.sleep(0)  # turns of the loop in which those that were closed are noticed
        while self._idle:
            reader, writer = self._idle.pop()
            if not reader.at_eof() and not writer.is_closing():
                return reader, writer
            writer.close()
        api = await self._look_up()
        try:
            reader, writer = await connect(api)
        except (OSError, ValueError) as error:
            raise _Gone(str(error)) from None
        try:
            writer.write(
                encode_header(
                    {
                        "callerid": self._node.name,
                        "md5sum": self._ros1.md5,
                        "persistent": "1",
                        "service": self.service,
                        "type": self._ros1.name,
                    }
                )
            )
            fields = await read_header(reader)
        except (OSError, EOFError) as error:
            writer.close()
            raise _Gone(str(error)) from None
        except BaseException as error:
            writer.close()
            if isinstance(error, InvalidFrame):
                raise CallFailed(self.service, f"its provider does not speak TCPROS: {error}") from None
            raise
        if "error" in fields:
            writer.close()
            raise CallFailed(self.service, fields["error"])
        return reader, writer

    async def _look_up(self) -> str:
        async with self._looking:
            if self._api is None:
                try:
                    self._api = await self._node.master.lookup_service(self.service)
                except ConnectFailed as error:
                    raise _Gone(str(error)) from None
            if self._api is None or self._api == self._node.service_api:
                raise _Gone(self.service)
            return self._api

    async def _ask(self, stream: Stream, raw: bytes) -> bytes:
        reader, writer = stream
        done = False
        try:
            writer.write(struct.pack("<I", len(raw)))
            writer.write(raw)
            good = (await reader.readexactly(1))[0]
            answer = await read_frame(reader)
            done = True
        except (OSError, EOFError) as error:
            self._api = None
            raise ProviderLost(self.service, str(error) or "its connection was closed") from None
        except InvalidFrame as error:
            raise CallFailed(self.service, f"its provider does not speak TCPROS: {error}") from None
        finally:
            if done and not self.closed and len(self._idle) < _IDLE_LIMIT:
                self._idle.append(stream)
            else:
                writer.close()
        if not good:
            raise CallFailed(self.service, answer.decode("utf-8", "replace"))
        try:
            return self._response.from_ros1(answer)
        except TypesError as error:
            raise CallFailed(self.service, str(error)) from None

    async def _leave(self) -> None:
        await close_streams(self._forget())

    def _forget(self) -> list[asyncio.StreamWriter]:
        """Forget the provider, so that the next call looks it up again; return the streams to close."""
        self._api = None
        writers = [writer for _, writer in self._idle]
        self._idle.clear()
        for writer in writers:
            writer.close()
        return writers
