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
        ("rosapi_msgs/msg/TypeDef", "dcd2549139d3fdb432e7f925fe79e9fb4f02889c79be45f7482c346706734928"),
        ("rosapi_msgs/srv/NodeDetails", "37ad3ea5a79a1b09aa63efbb8267acabbac80e50d7fa61f5a14e197fff92d7d9"),
        ("rosapi_msgs/srv/TopicsAndRawTypes", "c900dd8bf8cba118ceaf9291072d1d957a69459fc8601146923e8375ed0a7947"),
        ("rosbridge_msgs/msg/ConnectedClients", "8bccb383266f3b69f4d4b8e13032d295f15ef6ff44981c4cd2f13ecd4d60cd14"),
    ],
)
def test_hashes(name: str, hash: str) -> None:
    """The definitions are those of the original: their hashes are the same."""
    assert _registry.hash(name) == f"RIHS01_{hash}"
