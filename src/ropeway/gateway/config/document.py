"""JSON and YAML texts read strictly: no key twice, no number that JSON lacks, faults with line and column.

YAML is read by its 1.2 core rules: ``on`` and ``yes`` are texts, ``1e-3`` is a number, ``12:30`` is no clock.
"""

from __future__ import annotations

import json
import re
from collections.abc import Hashable
from pathlib import Path
from typing import Any, Final

import yaml

from ropeway.errors import ConfigError

__all__ = ["read_file", "read_json", "read_yaml"]

_TOP: Final = "(top level)"


def read_file(path: str | Path) -> Any:
    """Read the value in a ``.json``, ``.yaml`` or ``.yml`` file; for other names, the first character decides.

    Raises ``ConfigError`` where the file cannot be read or is malformed.
    """
    file = Path(path)
    try:
        text = file.read_bytes().decode("utf-8-sig")
    except OSError as error:
        raise ConfigError([(_TOP, f"cannot be read: {error.strerror or error}")], str(path)) from error
    except UnicodeDecodeError as error:
        raise ConfigError([(_TOP, f"is not UTF-8 text: byte {error.start} is {error.reason}")], str(path)) from error
    suffix = file.suffix.lower()
    if suffix == ".json" or (suffix not in (".yaml", ".yml") and text.lstrip()[:1] in ("{", "[")):
        return read_json(text, str(path))
    return read_yaml(text, str(path))


class _Repeated(dict[str, Any]):
    """An object in which keys stand twice; found while parsing, reported once its path is known."""

    repeated: list[str]


def _pairs(pairs: list[tuple[str, Any]]) -> dict[str, Any]:
    plain = dict(pairs)
    if len(plain) == len(pairs):
        return plain
    marked = _Repeated(plain)
    seen: set[str] = set()
    marked.repeated = [key for key, _ in pairs if key in seen or seen.add(key)]  # type: ignore[func-returns-value]
    return marked


def _no_constant(text: str) -> Any:
    raise ValueError(f"{text} is not a JSON number")


def _find_repeated(value: Any, path: str, problems: list[tuple[str, str]]) -> None:
    if isinstance(value, dict):
        if isinstance(value, _Repeated):
            said = "this key stands twice in one object; keep one"
            problems.extend((f"{path}.{key}".lstrip("."), said) for key in dict.fromkeys(value.repeated))
        for key, item in value.items():
            _find_repeated(item, f"{path}.{key}".lstrip("."), problems)
    elif isinstance(value, list):
        for index, item in enumerate(value):
            _find_repeated(item, f"{path}[{index}]", problems)


def read_json(text: str, source: str = "") -> Any:
    """Parse a JSON text.

    Raises ``ConfigError`` naming line and column, or the path of a key that stands twice.
    """
    try:
        value = json.loads(text, object_pairs_hook=_pairs, parse_constant=_no_constant)
    except json.JSONDecodeError as error:
        where = f"line {error.lineno} column {error.colno}"
        raise ConfigError([(where, f"not JSON: {error.msg[:1].lower()}{error.msg[1:]}")], source) from error
    except ValueError as error:
        raise ConfigError([(_TOP, f"not JSON: {error}")], source) from error
    except RecursionError as error:
        raise ConfigError([(_TOP, "nested too deeply")], source) from error
    problems: list[tuple[str, str]] = []
    _find_repeated(value, "", problems)
    if problems:
        raise ConfigError(problems, source)
    return value


class _Loader(yaml.SafeLoader):
    """The safe loader with the scalars of YAML 1.2's core schema and without repeated keys."""

    def construct_mapping(self, node: yaml.MappingNode, deep: bool = False) -> dict[Hashable, Any]:
        seen: dict[Hashable, yaml.Mark] = {}
        for key_node, _ in node.value:
            if key_node.tag == "tag:yaml.org,2002:merge":
                continue
            key = self.construct_object(key_node, deep=True)
            if not isinstance(key, Hashable):
                raise yaml.constructor.ConstructorError(None, None, "a key must be a text", key_node.start_mark)
            if key in seen:
                raise yaml.constructor.ConstructorError(
                    None,
                    None,
                    f"the key {key!r} stands twice in one object, first in line {seen[key].line + 1}; keep one",
                    key_node.start_mark,
                )
            seen[key] = key_node.start_mark
        return super().construct_mapping(node, deep)


_CORE: Final = {
    "bool": (r"^(?:true|True|TRUE|false|False|FALSE)$", "tTfF"),
    "null": (r"^(?:~|null|Null|NULL|)$", ["~", "n", "N", ""]),
    "int": (r"^(?:[-+]?[0-9]+|0o[0-7]+|0x[0-9a-fA-F]+)$", "-+0123456789"),
    "float": (
        r"^(?:[-+]?(?:\.[0-9]+|[0-9]+(?:\.[0-9]*)?)(?:[eE][-+]?[0-9]+)?|[-+]?\.(?:inf|Inf|INF)|\.(?:nan|NaN|NAN))$",
        "-+.0123456789",
    ),
    "merge": (r"^(?:<<)$", "<"),
}
_Loader.yaml_implicit_resolvers = {}
for _tag, (_pattern, _first) in _CORE.items():
    _Loader.add_implicit_resolver(f"tag:yaml.org,2002:{_tag}", re.compile(_pattern), list(_first))


def _core_int(loader: _Loader, node: yaml.ScalarNode) -> int:
    text = loader.construct_scalar(node)
    base = {"0o": 8, "0x": 16}.get(text[:2], 10)
    return int(text[2:] if base != 10 else text, base)


_Loader.add_constructor("tag:yaml.org,2002:int", _core_int)


def read_yaml(text: str, source: str = "") -> Any:
    """Parse a YAML text. Raises ``ConfigError`` naming line and column of the fault."""
    try:
        return yaml.load(text, Loader=_Loader)  # noqa: S506 - a SafeLoader
    except yaml.MarkedYAMLError as error:
        mark = error.problem_mark or error.context_mark
        where = f"line {mark.line + 1} column {mark.column + 1}" if mark else _TOP
        raise ConfigError([(where, f"not YAML: {error.problem or error.context}")], source) from error
    except yaml.YAMLError as error:
        raise ConfigError([(_TOP, f"not YAML: {' '.join(str(error).split())}")], source) from error
    except ValueError as error:
        raise ConfigError([(_TOP, f"not YAML: {error}")], source) from error
    except RecursionError as error:
        raise ConfigError([(_TOP, "nested too deeply")], source) from error
