"""Shares a broker, and graphs at it, among the tests."""

from __future__ import annotations

from collections.abc import AsyncIterator, Iterator
from contextlib import AsyncExitStack
from typing import Any

import pytest

from ropeway.networks.mqtt.address import parse_address
from ropeway.networks.mqtt.graph import MqttGraph

from .broker import HAS_BROKER, WHY_NOT, Broker
from .device import Device


@pytest.fixture
def broker() -> Iterator[Broker]:
    """A broker of its own for a test."""
    if not HAS_BROKER:
        pytest.skip(WHY_NOT)
    with Broker() as started:
        yield started


class Place:
    """Makes graphs and devices at a broker, and closes them at the end."""

    def __init__(self, broker: Broker, stack: AsyncExitStack) -> None:
        self.broker, self.stack = broker, stack

    async def graph(self, name: str = "near", query: str = "", **options: Any) -> MqttGraph:
        """An open graph."""
        url = query if query.startswith("mqtt") else f"{self.broker.url}{query}"
        made = MqttGraph(parse_address(url), node=name, **options)
        await made.open()
        self.stack.push_async_callback(made.close)
        return made

    def device(self, *filters: str, **options: Any) -> Device:
        """A client of another make that reads these filters."""
        return self.stack.enter_context(Device(self.broker, *filters, **options))


@pytest.fixture
async def place(broker: Broker) -> AsyncIterator[Place]:
    """Graphs and devices at a broker."""
    async with AsyncExitStack() as stack:
        yield Place(broker, stack)
