"""ropeway.gateway.process.counts."""

from __future__ import annotations

from ropeway.gateway.process.counts import summed


def test_sums() -> None:
    """Counts are added up by name; what only one has stays."""
    assert summed([{"a": {"x": 1}, "b": {}}, {"a": {"x": 2, "y": 1}}]) == {"a": {"x": 3, "y": 1}, "b": {}}
    assert summed([]) == {}
