"""ropeway.gateway.needed_modules: what a configuration needs beyond what every gateway has loaded."""

from __future__ import annotations

import ast
import importlib.util
import json
import re
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path
from types import ModuleType
from typing import Any

import pytest

from ropeway.gateway import gateway, local_networks, remote_factory, running_remote
from ropeway.gateway import needed_modules as names
from ropeway.gateway.config.config import parse
from ropeway.gateway.needed_modules import needed_modules
from ropeway.gateway.recording import recorders

_PROGRAM = """
import importlib, json, sys
for name in sys.argv[1:]:
    importlib.import_module(name)
print(json.dumps(list(sys.modules)))
"""
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
        ({}, [{"address": "mqtt://h:1", "publish": [_ITEM]}], {"networks.mqtt.graph", "networks.mqtt.maps"}),
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
    for name in needed(everything):
        assert importlib.util.find_spec(name), name


def imported_late(of: ModuleType) -> Iterator[str]:
    """Yield the modules that the functions of a module import."""
    for function in ast.walk(ast.parse(Path(str(of.__file__)).read_text("utf-8"))):
        if isinstance(function, (ast.FunctionDef, ast.AsyncFunctionDef)):
            for node in ast.walk(function):
                if isinstance(node, ast.ImportFrom):
                    yield str(node.module)


def strings(of: ModuleType) -> Iterator[str]:
    """Yield the strings in the source of a module."""
    for node in ast.walk(ast.parse(Path(str(of.__file__)).read_text("utf-8"))):
        if isinstance(node, ast.Constant) and isinstance(node.value, str):
            yield node.value


def test_none_is_forgotten() -> None:
    """What the functions that make the parts of a gateway import is loaded with the modules that are named here."""
    named = [text for text in strings(names) if re.fullmatch(r"ropeway(\.\w+)+", text)]
    done = subprocess.run([sys.executable, "-c", _PROGRAM, *named], capture_output=True, text=True, check=True)
    makers = (gateway, local_networks, recorders, remote_factory, running_remote)
    late = {name for each in makers for name in imported_late(each)}
    assert late
    assert late - set(json.loads(done.stdout)) == set()
