"""A megabyte of anything makes a gateway hold a few megabytes, and nothing once who sent it has left."""

from __future__ import annotations

from collections.abc import Iterator

import pytest

from tests.soak.kinds import KINDS, Kind
from tests.soak.measure import grown_by
from tests.support.isolation import isolated_dds

PEAK_BYTES = 16 << 20
LEFT_BYTES = 16 << 20  # pages that the allocators keep for the next

KEPT_BYTES = 64 << 20  # a megabyte is up to 40,000 values; the store keeps them, within its own limits
HANDSHAKES_BYTES = 64 << 20  # of TLS, from hundreds of addresses: what was given up is not free at once
KEPT = ("node-plain", "node-systems", "node-plain-unread", "node-systems-unread")
HANDSHAKES = ("half-open-tls-everywhere",)

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
    if kind.name in KEPT:
        assert growth.left.keys() <= {"Entry"}
        assert growth.peak_bytes < KEPT_BYTES
    elif kind.name in HANDSHAKES:
        assert growth.left == {}
        assert growth.peak_bytes < HANDSHAKES_BYTES
    else:
        assert growth.left == {}
        assert growth.peak_bytes < PEAK_BYTES
        assert growth.left_bytes < LEFT_BYTES
