"""A megabyte of clients that read nothing of what they are told: a file of its own, which runs beside the others."""

from __future__ import annotations

import pytest

from tests.soak.growth import holds_little
from tests.soak.kinds import UNREAD, Kind

pytestmark = [pytest.mark.slow, pytest.mark.timeout(300)]


@pytest.mark.parametrize("kind", UNREAD, ids=lambda kind: kind.name)
async def test_a_megabyte(kind: Kind) -> None:
    """A gateway that gets a megabyte holds some more while it is there, and is what it was once all have left."""
    await holds_little(kind)
