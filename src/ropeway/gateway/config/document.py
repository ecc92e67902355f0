"""JSON and YAML files read strictly: no key twice, no number that JSON lacks, faults with line and column."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

from ropeway.errors import TOP_LEVEL, ConfigError

__all__ = ["read_file", "read_json"]


def read_file(path: str | Path) -> Any:
    """Read the value in a ``.json``, ``.yaml`` or ``.yml`` file; for other names, the first character decides.

    Raises ``ConfigError`` where the file cannot be read or is malformed.
    """
    file = Path(path)
    try:
        text = file.read_bytes().decode("utf-8-sig")
    except OSError as error:
        raise ConfigError([(TOP_LEVEL, f"cannot be read: {error.strerror or error}")], str(path)) from error
    except UnicodeDecodeError as error:
        raise ConfigError(
            [(TOP_LEVEL, f"is not UTF-8 text: byte {error.start} is {error.reason}")], str(path)
        ) from error
    suffix = file.suffix.lower()
    if suffix == ".json" or (suffix not in (".yaml", ".yml") and text.lstrip()[:1] in ("{", "[")):
        return read_json(text, str(path))
    from ropeway.gateway.config.yaml_text import read_yaml  # a megabyte that JSON does not need

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
    problems: list[tuple[str, str]] = []
    try:
        value = json.loads(text, object_pairs_hook=_pairs, parse_constant=_no_constant)
        _find_repeated(value, "", problems)
    except json.JSONDecodeError as error:
        where = f"line {error.lineno} column {error.colno}"
        raise ConfigError([(where, f"not JSON: {error.msg[:1].lower()}{error.msg[1:]}")], source) from error
    except ValueError as error:
        raise ConfigError([(TOP_LEVEL, f"not JSON: {error}")], source) from error
    except RecursionError as error:
        raise ConfigError([(TOP_LEVEL, "nested too deeply")], source) from error
    if problems:
        raise ConfigError(problems, source)
    return value
