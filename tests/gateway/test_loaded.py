"""What a gateway loads: a robot's memory is small, and its gateway has to be up soon."""

from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path
from typing import Any

from ropeway.networks.overlay.crypto.identity import write_private
from tests.networks.overlay.fleet import member

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
_LONGEST_S = 240
_REMOTE = {"address": "ws://127.0.0.1:1", "publish": [{"name": "/a", "type": "std_msgs/msg/String"}]}


_CHANGES = """
import asyncio, json, sys, threading
from ropeway.gateway.config.config import parse
from ropeway.gateway.gateway import Gateway

imported = []

def note(event, args):
    if event == "import" and threading.current_thread() is threading.main_thread():
        imported.append(args[0])

async def main(first, *changes):
    found = {}
    async with Gateway(parse(first)) as gateway:
        sys.addaudithook(note)
        for change in changes:
            imported.clear()
            await gateway.apply(parse(change))
            found[json.dumps(change)] = list(imported)
    print(json.dumps(found))

asyncio.run(main(*map(json.loads, sys.argv[1:])))
"""
_STRINGS = {"name": "/a", "type": "std_msgs/msg/String"}
_MEMBERS = ["ws://127.0.0.1:1", "ws://127.0.0.1:2"]
_TRIGGER = {"name": "/s", "type": "std_srvs/srv/Trigger"}


def told(program: str, *given: dict[str, Any]) -> Any:
    """Return what a program prints last, as JSON."""
    command = [sys.executable, "-c", program, *map(json.dumps, given)]
    done = subprocess.run(command, capture_output=True, text=True, timeout=_LONGEST_S)
    assert done.returncode == 0, done.stderr
    return json.loads(done.stdout.splitlines()[-1])


def loaded(configuration: dict[str, Any]) -> set[str]:
    """Return the modules of a process that brought a gateway up and down."""
    return set(told(_PROGRAM, configuration))


def changed(*configurations: dict[str, Any]) -> dict[str, list[str]]:
    """Return what the thread of the event loop imports when a running gateway goes from each to the next."""
    found: dict[str, list[str]] = told(_CHANGES, *configurations)
    return found


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


def test_a_change_loads_nothing_where_messages_cross(tmp_path: Path) -> None:
    """What a remote or a route of any kind needs is imported in a thread, while the event loop goes on."""
    bundle = tmp_path / "robot.ropeway"
    write_private(bundle, member().to_text())
    overlay = {"identity": str(bundle), "routers": [], "listen": []}
    remotes: list[dict[str, Any]] = [
        _REMOTE,
        {"address": "ws://127.0.0.1:1", "expose-service": [_TRIGGER], "publish": [{**_STRINGS, "audit": True}]},
        {"address": _MEMBERS, "expose-service": [_TRIGGER]},
        {"address": "ws://127.0.0.1:1", "interfaces": ["lo", "eth7"], "publish": [_STRINGS]},
        {"address": "iort://127.0.0.1:1", "publish": [_STRINGS]},
        {"address": "overlay", "publish": [_STRINGS]},
        {"address": "overlay", "automatic": {"allow": ["/b"]}},
        {"address": "overlay", "anycast": {}, "expose-service": [_TRIGGER]},
    ]
    gateway = {"graphs": ["memory:a"], "listen": [], "overlay": overlay, "store": {"path": "memory:"}}
    found = changed({"gateway": gateway}, *({"gateway": gateway, "remotes": [remote]} for remote in remotes))
    assert len(found) == len(remotes)
    assert {change: names for change, names in found.items() if names} == {}
