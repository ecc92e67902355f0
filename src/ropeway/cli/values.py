"""Reads the values of messages, requests and goals from the command line."""

from __future__ import annotations

import sys
from typing import Any

from ropeway.cli.console import fail
from ropeway.errors import ConfigError
from ropeway.gateway.config.yaml_text import read_yaml
from ropeway.types import TypeRegistry
from ropeway.types.cast import cast

__all__ = ["fitted", "parse_values", "typed_values"]


def typed_values(text: str, *, stdin: bool) -> dict[str, Any]:
    """Return the fields in ``text``, or in what standard input holds; see ``parse_values``."""
    return parse_values(sys.stdin.read() if stdin else text)


def parse_values(text: str) -> dict[str, Any]:
    """Return the fields in a YAML (or JSON) text, or end with a sentence where it is no mapping."""
    try:
        values = read_yaml(text)
    except ConfigError as error:
        where, what = error.problems[0]
        fail(f"the values cannot be read: {where}: {what}", 2)
    if values is None:
        return {}
    if not isinstance(values, dict):
        fail(f"the values need to be a mapping in YAML, such as '{{data: hi}}', not {text!r}", 2)
    return values


def fitted(registry: TypeRegistry, type: str, values: dict[str, Any]) -> dict[str, Any]:
    """Return ``values`` cast to the fields of ``type``, once it is certain that a message can be made of them.

    Raises ``ValueMismatch`` and ``UnknownType``.
    """
    codec = registry.codec(type)
    made: dict[str, Any] = cast(codec.type, values, registry.definition)
    codec.from_json(made)
    return made
