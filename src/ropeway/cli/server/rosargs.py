"""Parses what ROS 2 puts on a node's command line: ``--ros-args -p port:=9091 -r __node:=name --params-file FILE …
--``.
"""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Final

from ropeway.errors import TOP_LEVEL, ConfigError
from ropeway.gateway.config.document import read_file
from ropeway.gateway.config.yaml_text import read_yaml

__all__ = ["RosArgs", "split"]

_WITH_VALUE: Final = frozenset(("-e", "--enclave", "--log-config-file", "--log-file-name"))
_SWITCHES: Final = re.compile(r"--(?:enable|disable)-(?:rosout-logs|stdout-logs|external-lib-logs)")
_LEVELS: Final = {"warn": "warning", "fatal": "error", "unset": "info"}


@dataclass
class RosArgs:
    """The content of ROS arguments. ``notes`` are sentences about what has no effect here."""

    node: str
    namespace: str = "/"
    log_level: str = ""
    parameters: dict[str, Any] = field(default_factory=dict)
    notes: list[str] = field(default_factory=list)

    @property
    def full_name(self) -> str:
        """The node with its namespace."""
        return f"{self.namespace.rstrip('/')}/{self.node}"


def split(arguments: Sequence[str], node: str) -> tuple[list[str], RosArgs]:
    """Separate the other arguments from what the ROS arguments say about ``node``, unless they rename it.

    Raises ``ConfigError`` for what is malformed or cannot be read.
    """
    others: list[str] = []
    sections: list[str] = []
    inside = False
    for argument in arguments:
        if argument == "--ros-args":
            inside = True
        elif inside and argument == "--":
            inside = False
        else:
            (sections if inside else others).append(argument)
    said = RosArgs(node)
    pairs = list(_pairs(sections))
    for kind, value in pairs:
        if kind == "remap":
            _remap(said, value)
    for kind, value in pairs:
        if kind == "param":
            _parameter(said, value)
        elif kind == "file":
            _file(said, value)
        elif kind == "level":
            logger, found, level = value.rpartition(":=")
            if not found or logger.strip("/").replace("/", ".") in (said.node, said.full_name.strip("/")):
                said.log_level = _LEVELS.get(level.lower(), level.lower())
    return others, said


def _pairs(arguments: Sequence[str]) -> Iterator[tuple[str, str]]:
    kinds = {
        "-p": "param",
        "--param": "param",
        "-r": "remap",
        "--remap": "remap",
        "--params-file": "file",
        "--log-level": "level",
    }
    rest = iter(arguments)
    for argument in rest:
        kind = kinds.get(argument, "other" if argument in _WITH_VALUE else "")
        if kind:
            value = next(rest, None)
            if value is None:
                raise _wrong(argument, "a value has to follow")
            yield kind, value
        elif not _SWITCHES.fullmatch(argument):
            raise _wrong(argument, "this is not a ROS argument")


def _remap(said: RosArgs, text: str) -> None:
    name, found, value = text.partition(":=")
    if not found:
        raise _wrong(f"-r {text}", "expected FROM:=TO")
    match name.rpartition(":")[2]:
        case "__node" | "__name":
            said.node = value
        case "__ns":
            said.namespace = value if value.startswith("/") else f"/{value}"
            if said.namespace != "/":
                said.notes.append(f"the namespace {value} (relative names of clients start at / here)")
        case _:
            said.notes.append(f"the remapping {text} (the names of clients are taken as they are)")


def _parameter(said: RosArgs, text: str) -> None:
    name, found, value = text.partition(":=")
    if not found:
        raise _wrong(f"-p {text}", "expected NAME:=VALUE")
    node, _, name = name.rpartition(":")
    if node and node.strip("/") not in (said.node, said.full_name.strip("/")):
        said.notes.append(f"the parameter {name} of {node} (this node is {said.full_name})")
        return
    said.parameters[name] = read_yaml(value, f"-p {text}")


def _file(said: RosArgs, path: str) -> None:
    sections = list(_sections(read_file(Path(path)), "", path))
    if not sections:
        text = f"no ros__parameters stand in it; expected {said.full_name}: {{ros__parameters: {{port: 9091}}}}"
        raise ConfigError([(TOP_LEVEL, text)], path)
    ours = [parameters for pattern, parameters in sections if _names(pattern, said)]
    if not ours:
        named = ", ".join(dict.fromkeys(pattern for pattern, _ in sections))
        text = f"it has parameters of {named}, and none of {said.full_name}; /** names every node"
        raise ConfigError([(TOP_LEVEL, text)], path)
    for parameters in ours:
        said.parameters.update(_flat(parameters, ""))


def _sections(value: Any, node: str, path: str) -> Iterator[tuple[str, Mapping[str, Any]]]:
    """Yield the pattern of nodes and the parameters of each section of a parameter file."""
    if not isinstance(value, Mapping):
        return
    for key, inner in value.items():
        if key != "ros__parameters":
            yield from _sections(inner, f"{node}/{str(key).strip('/')}", path)
        elif not isinstance(inner, Mapping):
            raise ConfigError([(f"{node} ros__parameters", "expected an object with parameters")], path)
        elif not node:
            raise ConfigError([("ros__parameters", "it stands below no node; put it below /** or the node")], path)
        else:
            yield node, inner


def _flat(parameters: Mapping[str, Any], prefix: str) -> Iterator[tuple[str, Any]]:
    """Yield names and values; what stands below a name is joined to it with a dot."""
    for key, value in parameters.items():
        if isinstance(value, Mapping):
            yield from _flat(value, f"{prefix}{key}.")
        else:
            yield f"{prefix}{key}", value


def _names(pattern: str, said: RosArgs) -> bool:
    """Return whether the key of a parameter file stands for the node, by the rules of ROS 2."""
    parts = [
        "(?:/[^/]+)*" if part == "**" else "/[^/]+" if part == "*" else "/" + re.escape(part)
        for part in pattern.strip("/").split("/")
    ]
    return re.fullmatch("".join(parts), said.full_name) is not None


def _wrong(what: str, text: str) -> ConfigError:
    return ConfigError([(what, text)], "--ros-args")
