"""ropeway.listener.handshakes: failed TLS handshakes are told by the listener they were made at."""

from __future__ import annotations

import asyncio
import itertools
import logging
import ssl
from typing import Any

import pytest

from ropeway.listener.connection import Limits
from ropeway.listener.listener import Listener
from ropeway.listener.websocket import listen
from tests.support.until import until

_hosts = itertools.count(2)


async def secure_listener() -> Listener:
    context = ssl.SSLContext(ssl.PROTOCOL_TLS_SERVER)
    host = f"127.0.0.{next(_hosts)}"  # the address of a listener has the port that was asked for, 0
    return await listen(host, 0, lambda _: None, limits=Limits(), ssl_context=context)


async def knock(listener: Listener) -> None:
    host = listener.address.split(":")[1].removeprefix("//")
    _, writer = await asyncio.open_connection(host, listener.port)
    writer.write(b"\x16\x03\x01\x02\x00\x01")  # the beginning of a hello
    await writer.drain()
    writer.transport.abort()


async def test_each_listener_tells_of_its_own(caplog: pytest.LogCaptureFixture) -> None:
    """A failed handshake is logged with the address of the listener at which it was tried."""
    caplog.set_level(logging.WARNING, "ropeway.link")
    listeners = [await secure_listener() for _ in range(3)]
    for listener in listeners:
        await knock(listener)
    await until(lambda: len(caplog.messages) == 3)
    assert {message.partition(": bad handshake")[0] for message in caplog.messages} == {
        listener.address for listener in listeners
    }
    for listener in listeners:
        await listener.close()


async def test_the_handler_is_given_back() -> None:
    """However many listeners come and go, the loop has the exception handler that it had before."""
    loop = asyncio.get_running_loop()
    told: list[dict[str, Any]] = []

    def before(_: asyncio.AbstractEventLoop, context: dict[str, Any]) -> None:
        told.append(context)

    loop.set_exception_handler(before)
    listeners = [await secure_listener() for _ in range(3)]
    during = loop.get_exception_handler()
    assert during is not before
    loop.call_exception_handler({"message": "something else"})
    assert told == [{"message": "something else"}]
    for listener in listeners[:2]:
        await listener.close()
    assert loop.get_exception_handler() is during
    await listeners[2].close()
    assert loop.get_exception_handler() is before
