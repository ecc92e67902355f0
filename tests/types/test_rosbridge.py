"""ropeway.types.rosbridge: the interfaces of rosbridge are known."""

from __future__ import annotations

import pytest

from ropeway.types import TypeRegistry
from ropeway.types.rosbridge import ROSBRIDGE_INTERFACES
from ropeway.types.stores import DISTROS

_registry = TypeRegistry()


def test_all_are_known() -> None:
    """Every message and service can be read and written, in every distribution of ROS 2."""
    for name in ROSBRIDGE_INTERFACES:
        assert _registry.has(name)
        for part in ("_Request", "_Response") if "/srv/" in name else ("",):
            codec = _registry.codec(name + part)
            assert codec.encode(codec.default())


@pytest.mark.parametrize("distro", DISTROS)
def test_in_every_distribution(distro: str) -> None:
    """The messages that the server publishes are known whatever distribution is chosen."""
    assert TypeRegistry(distro).codec("rosbridge_msgs/msg/ConnectedClients").fields == ("clients",)


@pytest.mark.parametrize(
    ("name", "hash"),
    [
HASHES
    ],
)
def test_hashes(name: str, hash: str) -> None:
    """The definitions are those of the original: their hashes are the same."""
    assert _registry.hash(name) == f"RIHS01_{hash}"
