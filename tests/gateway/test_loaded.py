"""What a gateway loads: a robot's memory is small, and its gateway has to be up soon."""

from __future__ import annotations

import json
import subprocess
import sys
from typing import Any

_PROGRAM = """
import asyncio, json, sys
from ropeway.gateway.config.config import parse
from ropeway.gateway.gateway import Gateway

async def main():
    async with Gateway(parse(json.loads(sys.argv[1]))):
        pass
    print(json.dumps(list(sys.modules)))

asyncio.run(main())
"""
_REMOTE = {"address": "ws://127.0.0.1:1", "publish": [{"name": "/a", "type": "std_msgs/msg/String"}]}


def loaded(configuration: dict[str, Any]) -> set[str]:
    """Return the modules of a process that brought a gateway up and down."""
    command = [sys.executable, "-c", _PROGRAM, json.dumps(configuration)]
    done = subprocess.run(command, capture_output=True, text=True, check=True, timeout=60)
    return set(json.loads(done.stdout.splitlines()[-1]))


def test_a_gateway_that_dials_loads_only_what_it_needs() -> None:
    """Two graphs and a route need no numpy, YAML, cryptography, server, nodes of other makes, store or overlay."""
    modules = loaded({"gateway": {"graphs": ["memory:a"], "listen": []}, "remotes": [_REMOTE]})
    others = (
        "numpy",
        "yaml",
        "cryptography",
        "zenoh",
        "sqlite3",
        "urllib.request",
        "ropeway.iort",
        "ropeway.networks.rosbridge.server",
        "ropeway.networks.iort.graph",
        "ropeway.networks.dds",
        "ropeway.store",
    )
    assert not modules.intersection(others)


def test_a_gateway_loads_what_its_configuration_names() -> None:
    """A listener of each kind brings the server, the nodes and the store."""
    modules = loaded(
        {
            "gateway": {
                "graphs": ["memory:a"],
                "listen": ["ws://127.0.0.1:0", "iort://127.0.0.1:0"],
                "store": {"path": "memory:"},
            }
        }
    )
    assert modules >= {"ropeway.networks.rosbridge.server", "ropeway.networks.iort.server", "ropeway.store"}
