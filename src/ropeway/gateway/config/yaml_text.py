"""YAML texts read strictly, by the 1.2 core rules: ``on`` and ``yes`` are texts, ``1e-3`` is a number, ``12:30`` is no
clock; no key stands twice.
"""

from __future__ import annotations

import re
from collections.abc import Hashable
from typing import Any, Final

import yaml

from ropeway.errors import TOP_LEVEL, ConfigError

__all__ = ["read_yaml"]


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
        where = f"line {mark.line + 1} column {mark.column + 1}" if mark else TOP_LEVEL
        raise ConfigError([(where, f"not YAML: {error.problem or error.context}")], source) from error
    except yaml.YAMLError as error:
        raise ConfigError([(TOP_LEVEL, f"not YAML: {' '.join(str(error).split())}")], source) from error
    except ValueError as error:
        raise ConfigError([(TOP_LEVEL, f"not YAML: {error}")], source) from error
    except RecursionError as error:
        raise ConfigError([(TOP_LEVEL, "nested too deeply")], source) from error
