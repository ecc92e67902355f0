"""``service call`` without the terminal."""

from __future__ import annotations

import asyncio
import struct

import pytest
from typer.testing import CliRunner

from ropeway import aio
from ropeway.cli import app
from ropeway.cli.service.call import call
from ropeway.cli.session import OpenGraph
from ropeway.errors import CallFailed, NotServed, UnknownType, ValueMismatch
from ropeway.graph.calls import Request
from tests.support.services import ADD
from tests.support.until import PATIENCE_S

pytestmark = pytest.mark.jumping


async def add(request: Request) -> bytes:
    """Add the two numbers; 13 is refused."""
    numbers = struct.unpack("<qq", request.payload[4:20])
    if 13 in numbers:
        raise CallFailed("/add", "thirteen is not for adding")
    return b"\0\1\0\0" + struct.pack("<q", sum(numbers))


async def test_call(pair: tuple[OpenGraph, OpenGraph]) -> None:
    """The request is made of the values, and the response handed over."""
    here, there = pair
    await there.graph.create_service("/add", ADD, add)
    asked: list[bytes] = []
    told: list[bytes] = []
    await call(
        here,
        "/add",
        "example_interfaces/AddTwoInts",
        {"a": 40, "b": 2},
        timeout_s=5,
        asking=asked.append,
        told=told.append,
    )
    codec = here.registry.codec(f"{ADD}_Request")
    assert [codec.decode(request) for request in asked] == [{"a": 40, "b": 2}]
    assert [here.registry.codec(f"{ADD}_Response").decode(response) for response in told] == [{"sum": 42}]
    assert not here.graph.services()["/add"].clients


async def test_rate(pair: tuple[OpenGraph, OpenGraph]) -> None:
    """With a rate the call is made again and again."""
    here, there = pair
    await there.graph.create_service("/add", ADD, add)
    enough = asyncio.Event()
    told: list[bytes] = []

    def tell(response: bytes) -> None:
        told.append(response)
        if len(told) == 3:
            enough.set()

    calling = asyncio.create_task(call(here, "/add", ADD, {"a": 1}, timeout_s=5, rate_hz=100, told=tell))
    async with aio.timeout(PATIENCE_S):
        await enough.wait()
    calling.cancel()
    with pytest.raises(asyncio.CancelledError):
        await calling
    assert not here.graph.services()["/add"].clients


async def test_mistakes(pair: tuple[OpenGraph, OpenGraph]) -> None:
    """Wrong values and types are told before anything is sent; a failure of the provider is its text."""
    here, there = pair
    with pytest.raises(ValueMismatch):
        await call(here, "/add", ADD, {"c": 1}, timeout_s=5)
    with pytest.raises(UnknownType):
        await call(here, "/add", "example_interfaces/srv/AddTwoInt", {}, timeout_s=5)
    with pytest.raises(NotServed):
        await call(here, "/add", ADD, {}, timeout_s=0.05)
    await there.graph.create_service("/add", ADD, add)
    with pytest.raises(CallFailed, match="thirteen"):
        await call(here, "/add", ADD, {"a": 13}, timeout_s=5)


def test_nobody_serves_it() -> None:
    """A call of what nobody serves says so, after how long, and where to look."""
    result = CliRunner().invoke(
        app, ["service", "call", "/nothing", ADD, "{}", "-g", "memory:no-service", "--timeout", "0.2"]
    )
    assert result.exit_code == 1
    assert "nobody serves /nothing within 0.2 s" in result.output
    assert "ropeway service list" in result.output
