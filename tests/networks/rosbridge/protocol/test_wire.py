from __future__ import annotations

from ropeway.networks.rosbridge import protocol as wire


def test_the_public_names_are_there() -> None:
    """What the package says it has, it has, in order and once."""
    assert all(hasattr(wire, name) for name in wire.__all__)
    assert len(set(wire.__all__)) == len(wire.__all__)
