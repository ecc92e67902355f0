"""Requests to the control API of a running gateway, as bytes on a connection."""

from __future__ import annotations

import asyncio
import atexit
import functools
import socket
from typing import Any, Final

from fuzz.target import Target
from ropeway.control.admission import UnixAdmission
from ropeway.control.app import make_app
from ropeway.control.caller import Caller
from ropeway.control.manager import Manager
from ropeway.control.server import ControlServer
from ropeway.gateway.config.config import parse
from ropeway.gateway.gateway import Gateway

__all__ = ["TARGETS"]

_HEAD: Final = b" HTTP/1.1\r\nhost: x\r\ncontent-type: application/json\r\n"
_SEEDS: Final = (
    b"GET /v1/status" + _HEAD + b"\r\n",
    b"GET /metrics" + _HEAD + b"accept: application/openmetrics-text;version=1.0.0\r\n\r\n",
    b"GET /v1/events?after=1&name=/a" + _HEAD + b"\r\nGET /v1/explain?name=/a&to=b" + _HEAD + b"\r\n",
    b"DELETE /v1/sessions/10.0.0.1:5" + _HEAD + b"\r\n",
    b"GET /v1/topics/value?name=/a&after=1" + _HEAD + b"\r\n",
    b"GET /v1/audit?count=5&kind=denied&since=1&before=9" + _HEAD + b"\r\n",
    b"GET /v1/events/stream" + _HEAD + b"last-event-id: 4\r\n\r\n",
    b"POST /v1/topics/publish"
    + _HEAD
    + b'content-length: 63\r\n\r\n{"name":"/a","type":"std_msgs/msg/String","message":{"data":""}}',
    b"POST /v1/anycast/switch" + _HEAD + b'content-length: 27\r\n\r\n{"group":"a","member":"b"}  ',
    b"POST /v1/config/plan" + _HEAD + b'content-length: 27\r\n\r\n{"config":{"gateway":null}}',
    b"POST /v1/config/rollback" + _HEAD + b'transfer-encoding: chunked\r\n\r\nc\r\n{"number":1}\r\n0\r\n\r\n',
)


class _Watcher(UnixAdmission):
    """Lets everybody do all but change the configuration, which would make the next request another case."""

    async def admit(self, *_: Any, **__: Any) -> Caller:
        return Caller("fuzz", "fuzz", frozenset({"observe", "operate"}))


class _Transport(asyncio.Transport):
    """Keeps what is answered."""

    def __init__(self) -> None:
        super().__init__()
        self.answered = bytearray()
        self.ended = False
        self._socket = socket.socket()  # of the kind of TCP, connected to nothing

    def get_extra_info(self, name: str, default: Any = None) -> Any:
        known = {"peername": ("127.0.0.1", 1), "sockname": ("127.0.0.1", 2), "socket": self._socket}
        return known.get(name, default)

    def write(self, data: Any) -> None:
        self.answered += data

    def close(self) -> None:
        self.ended = True
        self._socket.close()

    abort = close

    def is_closing(self) -> bool:
        return self.ended

    def set_write_buffer_limits(self, high: int | None = None, low: int | None = None) -> None:
        """Take any limits: nothing waits here."""

    def pause_reading(self) -> None:
        """Go on: all there is has come."""

    resume_reading = pause_reading


@functools.cache
def _place() -> tuple[asyncio.AbstractEventLoop, ControlServer]:
    """Return an event loop, and the control API of a gateway that runs on it, for the whole process."""
    loop = asyncio.new_event_loop()
    settings = {"name": "fuzz", "graphs": ["memory:fuzz"], "listen": []}
    gateway = Gateway(parse({"gateway": settings, "remotes": []}))
    loop.run_until_complete(gateway.__aenter__())
    atexit.register(_end, loop, gateway)
    return loop, ControlServer(make_app(Manager(gateway), _Watcher()))


def _end(loop: asyncio.AbstractEventLoop, gateway: Gateway) -> None:
    loop.run_until_complete(gateway.__aexit__())
    loop.close()


def _request(data: bytes) -> None:
    loop, server = _place()
    answered = loop.run_until_complete(_answer(server, data))
    assert not answered.startswith(b"HTTP/1.1 500"), answered[:400]


async def _answer(server: ControlServer, data: bytes) -> bytes:
    transport, connection = _Transport(), server.connection()
    connection.connection_made(transport)
    if data:  # a transport never hands over nothing
        connection.data_received(data)
    for _ in range(100):  # turns of the loop, more than any answer takes that waits for nothing
        await asyncio.sleep(0)
    connection.connection_lost(None)
    await asyncio.sleep(0)
    transport.close()
    return bytes(transport.answered)


TARGETS: Final = {
    "control-requests": Target(
        _request,
        (),
        lambda: _SEEDS,
        (b"/v1/", b"config", b"history/", b"routes", b"events", b"stream", b"sessions", b"%2f", b"%00", b"\r\n", b"[["),
        memory_bytes=32 << 20,
        memory_per_byte=256,
        cpu_s=2.0,
    )
}
