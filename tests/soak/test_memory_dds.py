"""A megabyte of clients of a gateway on DDS: a file of its own, which runs beside the others."""

from __future__ import annotations

import pytest

from tests.soak.growth import holds_little
from tests.soak.kinds import ON_DDS, Kind

pytestmark = [pytest.mark.slow, pytest.mark.timeout(300)]


@pytest.mark.parametrize("kind", ON_DDS, ids=lambda kind: kind.name)
async def test_a_megabyte(kind: Kind) -> None:
    """A gateway that gets a megabyte holds some more while it is there, and is what it was once all have left."""
    await holds_little(kind)
