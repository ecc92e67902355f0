"""Fixtures of all tests."""

from __future__ import annotations

from collections.abc import AsyncIterator
from contextlib import AsyncExitStack

import pytest


@pytest.fixture
async def stack() -> AsyncIterator[AsyncExitStack]:
    """What the test has to end, in the order it is told."""
    async with AsyncExitStack() as made:
        yield made
