"""Servers on the other end of a link."""

from __future__ import annotations

from contextlib import AsyncExitStack

import pytest

from ropeway.listener.connection import Limits
from tests.networks.rosbridge.client.gateways import ScriptedGateway
from tests.support.rosbridge import REGISTRY, Cloud, FakeServer


@pytest.fixture
async def fake(stack: AsyncExitStack) -> FakeServer:
    """A plain server."""
    made = FakeServer()
    stack.push_async_callback(made.stop)
    await made.start()
    return made


@pytest.fixture
async def far(stack: AsyncExitStack) -> ScriptedGateway:
    """A gateway."""
    made = ScriptedGateway(REGISTRY)
    stack.push_async_callback(made.stop)
    await made.start()
    return made


@pytest.fixture
async def cloud(stack: AsyncExitStack, request: pytest.FixtureRequest) -> Cloud:
    made = Cloud(request.node.name, Limits())
    stack.push_async_callback(made.stop)
    await made.start()
    return made
