"""Configuration documents in JSON and YAML, and ROS parameter files."""

from __future__ import annotations

import json
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Final

from fuzz.target import Target
from fuzz.targets.nested import NESTED_JSON
from ropeway.cli.server.rosargs import split
from ropeway.errors import ConfigError
from ropeway.gateway.config import config
from ropeway.gateway.config.document import read_json
from ropeway.gateway.config.yaml_text import read_yaml

__all__ = ["TARGETS"]

_FULL: Final = {
    "gateway": {"name": "a", "graphs": ["dds:0"], "listen": ["ws://127.0.0.1:0"], "auth": {"roles": {"r": {}}}},
    "remotes": [
        {
            "address": "ws://host:9090",
            "publish": [{"name": "/a", "type": "std_msgs/msg/String", "rate_hz": 20, "qos": {"depth": 1}}],
            "expose-service": [{"name": "s", "type": "std_srvs/srv/Trigger", "timeout_s": 1}],
            "expose-action": [{"name": "f", "type": "example_interfaces/action/Fibonacci"}],
        }
    ],
}
_YAML: Final = """\
gateway: {name: a, graphs: [memory:x], store: true}
remotes:
- &r {address: 'iort://host', subscribe: [{name: /a, type: std_msgs/String, priority: command}]}
"""
_PARAMETERS: Final = (
    "/**:\n  ros__parameters: {port: 9090, topics_glob: \"['/a']\", address: ''}\nnode: {ros__parameters: {x: [1]}}\n"
)
_KEYS: Final = ("gateway", "remotes", "name", "type", "address", "auth", "overlay", "iort", "ros__parameters")
_WORDS: Final = (
    *(f'"{key}"'.encode() for key in _KEYS),
    *(b"null", b"1e999", b"!!", b"&a", b"*a", b"<<: ", b"? ", b"- ", b": "),
)


def _json(data: bytes) -> None:
    config.parse(read_json(data.decode(errors="replace"))).routes()


def _yaml(data: bytes) -> None:
    config.parse(read_yaml(data.decode(errors="replace"))).routes()


def _file(data: bytes) -> None:
    with TemporaryDirectory(prefix="fuzz-") as folder:
        path = Path(folder) / "parameters.yaml"
        path.write_bytes(data)
        split(["--ros-args", "--params-file", str(path)], "node")


TARGETS: Final = {
    "json-configuration": Target(
        _json,
        (ConfigError,),
        lambda: [*NESTED_JSON, json.dumps(_FULL).encode(), json.dumps(_FULL["remotes"]).encode()],
        _WORDS,
    ),
    "yaml-configuration": Target(
        _yaml, (ConfigError,), lambda: [_YAML.encode(), b"a: &a [*a]", b"- " * 1000], _WORDS, cpu_s=3.0
    ),
    "parameter-files": Target(_file, (ConfigError,), lambda: [_PARAMETERS.encode(), b"- " * 1000], _WORDS, cpu_s=3.0),
}
