"""ropeway.gateway.needed_modules: what a configuration needs beyond what every gateway has loaded."""

from __future__ import annotations

import importlib.util
from typing import Any

import pytest

from ropeway.gateway.config.config import parse
from ropeway.gateway.needed_modules import needed_modules

_ITEM = {"name": "/a", "type": "std_msgs/msg/String"}


def needed(gateway: dict[str, Any], *remotes: dict[str, Any]) -> set[str]:
    return set(
        needed_modules(parse({"gateway": {"graphs": ["memory:x"], "listen": [], **gateway}, "remotes": remotes}))
    )


@pytest.mark.parametrize(
    ("gateway", "remotes", "modules"),
    [
        ({}, [], set()),
        ({}, [{"address": "ws://h:1", "publish": [_ITEM]}], set()),
        ({}, [{"address": "iort://h:1", "publish": [_ITEM], "active": False}], set()),
        ({}, [{"address": "iort://h:1", "publish": [_ITEM]}], {"networks.iort.graph"}),
        ({}, [{"address": ["ws://h:1", "ws://h:2"], "publish": [_ITEM]}], {"gateway.group"}),
        ({}, [{"address": "ws://h:1", "interfaces": ["a", "b"], "publish": [_ITEM]}], {"gateway.links"}),
        ({}, [{"address": "ws://h:1", "publish": [{**_ITEM, "audit": True}]}], {"gateway.audit"}),
        ({"graphs": ["dds:0?interface=lo"]}, [], {"networks.dds.graph"}),
        ({"graphs": ["zenoh"]}, [], {"networks.zenoh.graph"}),
        ({"listen": ["iort://127.0.0.1:1"]}, [], {"gateway.nodes", "store", "listener.store_pages"}),
        ({"diagnostics": True}, [], {"gateway.diagnostics"}),
    ],
)
def test_kinds(gateway: dict[str, Any], remotes: list[dict[str, Any]], modules: set[str]) -> None:
    """Each kind of network, listener, remote and route names its modules; plain links name none."""
    memory = set() if "graphs" in gateway else {"ropeway.networks.memory.graph"}
    assert needed(gateway, *remotes) == memory | {f"ropeway.{module}" for module in modules}


def test_all_exist() -> None:
    """Every module that can be named is one."""
    everything = {
        "graphs": ["dds:0", "ros1", "ros2:0", "zenoh"],
        "listen": ["ws://127.0.0.1:1", "iort://127.0.0.1:2"],
        "rest": True,
        "diagnostics": True,
    }
    for module in needed(everything):
        assert importlib.util.find_spec(module), module
