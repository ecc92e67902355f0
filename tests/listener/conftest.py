"""Connections are tested on both event loops: tests elsewhere use asyncio's own, the command uses uvloop."""

from __future__ import annotations

import asyncio
from collections.abc import Callable

import pytest
import uvloop

from tests.support.place import bare, place

__all__ = ["bare", "place", "pytest_asyncio_loop_factories"]


def pytest_asyncio_loop_factories(item: pytest.Item) -> dict[str, Callable[[], asyncio.AbstractEventLoop]]:
    """The event loops that a test runs on, one after the other."""
    loops: dict[str, Callable[[], asyncio.AbstractEventLoop]] = {"asyncio": asyncio.new_event_loop}
    if item.path.name in ("test_connection.py", "test_http_upgrade.py"):
        loops["uvloop"] = uvloop.new_event_loop
    return loops
