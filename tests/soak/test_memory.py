"""A megabyte of anything makes a gateway hold a few megabytes, and nothing once who sent it has left."""

from __future__ import annotations

from collections.abc import Iterator

import pytest

from tests.soak.kinds import KINDS, Kind
from tests.soak.measure import grown_by
from tests.support.isolation import isolated_dds

PEAK_BYTES = 16 << 20
LEFT_BYTES = 16 << 20  # pages that the allocators keep for the next

KEPT_BYTES = 64 << 20  # a megabyte is up to 40,000 topics, which ten connections share; values are kept within limits
FROM_MANY = ("nodes-", "router-half", "router-unfinished")
HELD_BY_ZENOH = ("router-silent", "router-half-open-tls", "router-unfinished-tls")  # it lets go of ten a second

pytestmark = [pytest.mark.slow, pytest.mark.timeout(300)]


@pytest.fixture(autouse=True, scope="module")
def alone() -> Iterator[None]:
    """Gateways on DDS discover each other and no other test run."""
    with isolated_dds():
        yield


@pytest.mark.parametrize("kind", KINDS, ids=lambda kind: kind.name)
async def test_a_megabyte(kind: Kind) -> None:
    """A gateway that gets a megabyte holds some more while it is there, and is what it was once all have left."""
    growth = await grown_by(kind)
    kept = {"Entry"} if kind.name.startswith("node") else set()  # values of nodes, which others may read
    if kind.name in HELD_BY_ZENOH:
        kept = {"descriptors"}
    assert growth.left.keys() <= kept
    if kind.name.startswith(FROM_MANY):
        assert growth.peak_bytes < KEPT_BYTES
    else:
        assert growth.peak_bytes < PEAK_BYTES
        assert growth.left_bytes < LEFT_BYTES
