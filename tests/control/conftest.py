"""A gateway in this process with its control API, and clients of it."""

from __future__ import annotations

import itertools
from collections.abc import AsyncIterator, Awaitable, Callable
from contextlib import AsyncExitStack
from dataclasses import dataclass
from typing import Any

import httpx
import pytest

from ropeway.audit.note import NO_AUDIT
from ropeway.audit.trail import AuditTrail
from ropeway.control.client import ControlTarget, find_target
from ropeway.control.control import Control
from ropeway.control.manager import Manager
from ropeway.gateway.config import config
from ropeway.gateway.gateway import Gateway

_numbers = itertools.count()


@dataclass
class Controlled:
    """A gateway, its control API, and a client on the UNIX socket."""

    gateway: Gateway
    manager: Manager
    control: Control
    target: ControlTarget
    client: httpx.AsyncClient


Begin = Callable[..., Awaitable[Controlled]]


@pytest.fixture
async def begin() -> AsyncIterator[Begin]:
    """Begin gateways; everything that was begun ends with the test."""
    async with AsyncExitStack() as stack:

        async def begin(remotes: Any = (), *, trail: AuditTrail | None = None, **settings: Any) -> Controlled:
            number = next(_numbers)
            document = {
                "gateway": {
                    "name": f"gateway{number}",
                    "graphs": [f"memory:control-{number}"],
                    "listen": [],
                    **settings,
                },
                "remotes": list(remotes),
            }
            audit = NO_AUDIT if trail is None else trail
            gateway = await stack.enter_async_context(Gateway(config.parse(document), audit=audit))
            manager = Manager(gateway, None, trail)
            stack.push_async_callback(manager.close)
            control = await stack.enter_async_context(Control(manager))
            target = find_target(control.name)
            client = await stack.enter_async_context(target.async_client())
            return Controlled(gateway, manager, control, target, client)

        yield begin
