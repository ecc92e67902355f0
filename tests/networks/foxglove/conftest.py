"""A server of viewers, as a fixture."""

from __future__ import annotations

from collections.abc import AsyncIterator
from contextlib import AsyncExitStack

import pytest

from tests.networks.foxglove.viewer import Sight


@pytest.fixture
async def dark() -> AsyncIterator[Sight]:
    """A place whose server a test starts itself."""
    async with AsyncExitStack() as stack:
        yield Sight(stack)


@pytest.fixture
async def sight(dark: Sight) -> Sight:
    """A server that is up."""
    await dark.start()
    return dark
