"""How much a gateway may hold of a megabyte of anything, as the tests of each group of kinds ask."""

from __future__ import annotations

from typing import Final

from tests.soak.kinds import Kind
from tests.soak.measure import grown_by

__all__ = ["holds_little"]

_PEAK_BYTES: Final = 16 << 20
_LEFT_BYTES: Final = 16 << 20  # pages that the allocators keep for the next
_KEPT_BYTES: Final = (
    64 << 20
)  # a megabyte is up to 40,000 topics, which ten connections share; values are within limits
_FROM_MANY: Final = ("nodes-", "router-half", "router-unfinished")
_HELD_BY_ZENOH: Final = ("router-silent", "router-half-open-tls", "router-unfinished-tls")  # it lets go of ten a second


async def holds_little(kind: Kind) -> None:
    """Assert that a gateway holds little more while it gets a megabyte of a kind, and nothing once all have left."""
    growth = await grown_by(kind)
    kept = {"Entry"} if kind.name.startswith("node") else set()  # values of nodes, which others may read
    if kind.name in _HELD_BY_ZENOH:
        kept = {"descriptors"}
    assert growth.left.keys() <= kept, growth.left
    if kind.name.startswith(_FROM_MANY):
        assert growth.peak_bytes < _KEPT_BYTES, growth
    else:
        assert growth.peak_bytes < _PEAK_BYTES, growth
        assert growth.left_bytes < _LEFT_BYTES, growth
