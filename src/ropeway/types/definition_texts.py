"""Makes the definition texts that web clients get for every topic, so that every client can read all of them.

Lichtblick asks for the texts of all topics every three seconds and drops the whole list if one of them does not
parse. Its parser is stricter than ROS: names of fields are in small letters, a type in another package has two parts,
an ``int64`` is written in digits. So each text is looked through first. What does not pass is written anew from the
definition; where that cannot help, the text says so in a comment, which every client reads as a message without
fields.
"""

from __future__ import annotations

import re
import time
from collections.abc import Callable, Iterable, Sequence
from dataclasses import replace
from typing import TYPE_CHECKING, Final, NamedTuple

from ropeway.errors import TypesError, UnknownType
from ropeway.types.definition import HEADER, TIMES, Constant, Definition, Field, short_name

if TYPE_CHECKING:
    from ropeway.types import TypeRegistry
    from ropeway.types.ros1_spelling import Ros1Spelling

__all__ = ["Ros1Texts", "Texts", "is_readable"]

_RULE: Final = "=" * 80
_MOST: Final = 4096
_RETRY_S: Final = 10.0  # a definition that is missing may be learned from a peer

_LINE: Final = re.compile(
    r"(?P<base>[A-Za-z0-9_/]+)(?P<bound><=\d+)?(?:\[(?:<=)?\d*\])?[ \t]+(?P<name>[A-Za-z0-9_]+)"
    r"(?P<rest>.*)\Z"
)
_FIELD: Final = re.compile(r"[a-z][a-z0-9]*(?:_[a-z0-9]+)*\Z")
_CONSTANT: Final = re.compile(r"[A-Z][A-Z0-9]*(?:_[A-Z0-9]+)*\Z")
_QUOTED: Final = r"""(?:'(?:\\.|[^'\\])*'|"(?:\\.|[^"\\])*")"""
_INTEGER: Final = r"[-+]?[0-9]+"
_VALUES: Final = {
    "string": rf"""(?:{_QUOTED}|[^\s'"#\\\[][^#\\]*)""",
    "bool": "(?:[Tt]rue|[Ff]alse|0|1)",
    "float": r"[-+]?(?:[0-9]+\.?[0-9]*|\.[0-9]+)(?:[eE][-+]?[0-9]+)?",
    "int64": _INTEGER,
    "int": rf"(?:{_INTEGER}|0[xX][0-9A-Fa-f]+)",
}
_ITEMS: Final = {**_VALUES, "string": r"""(?:'[^'\\#]*'|"[^"\\#]*")"""}
_COMMENT: Final = r"\s*(?:#.*)?\Z"
_ASSIGNED: Final = {kind: re.compile(rf"\s*=\s*{value}{_COMMENT}") for kind, value in _VALUES.items()}
_DEFAULT: Final = {
    kind: re.compile(rf"\s+(?:{value}|\[\s*{_ITEMS[kind]}(?:\s*,\s*{_ITEMS[kind]})*\s*\]){_COMMENT}")
    for kind, value in _VALUES.items()
}
_NOTHING: Final = re.compile(_COMMENT)


class _Made(NamedTuple):
    """A text, and what tells that it still holds."""

    text: str
    source: str  # the registry's full text, "" for a failure
    missing: str = ""
    until_s: float = 0.0
    failed: bool = False


class Texts:
    """Makes full definition texts by type, once each."""

    def __init__(self, registry: TypeRegistry, *, clock: Callable[[], float] = time.monotonic) -> None:
        self._registry, self._clock = registry, clock
        self._made: dict[str, _Made] = {}

    def of(self, type: str) -> str:
        """Return the text of a message and all that it contains; if there is none, a comment that says why."""
        return self._look_up(type).text

    def find(self, type: str) -> str | None:
        """Return the same, ``None`` if there is none."""
        made = self._look_up(type)
        return None if made.failed else made.text

    def _look_up(self, type: str) -> _Made:
        made = self._made.get(type)
        if made is None or not self._holds(type, made):
            if len(self._made) >= _MOST:
                self._made.clear()
            made = self._made[type] = self._make(type)
        return made

    def _holds(self, type: str, made: _Made) -> bool:
        if made.source:
            return self._registry.full_text(type) is made.source  # the registry keeps it until a type changes
        return self._clock() < made.until_s and not (made.missing and self._registry.has(made.missing))

    def _make(self, type: str) -> _Made:
        try:
            if not self._registry.has(type):
                raise UnknownType(type)
            source = self._registry.full_text(type)
            if not source:  # a message without fields
                return _Made("", "", until_s=self._clock() + _RETRY_S)
            return _Made(_readable(type, source, self._registry), source)
        except TypesError as error:
            missing = error.name if isinstance(error, UnknownType) else ""
            return _Made(_failure(type, error), "", missing, self._clock() + _RETRY_S, failed=True)


class Ros1Texts:
    """Makes full definition texts as ROS 1 has them."""

    def __init__(self, spelling: Ros1Spelling) -> None:
        self._spelling = spelling

    def of(self, type: str) -> str:
        """Return the text of a message and all that it contains; if there is none, a comment that says why."""
        try:
            return self._spelling.text(type)
        except TypesError as error:
            return _failure(type, error)

    def find(self, type: str) -> str | None:
        """Return the same, ``None`` if there is none."""
        try:
            return self._spelling.text(type)
        except TypesError:
            return None


def _failure(type: str, reason: object) -> str:
    """Return what rosbridge sends in place of a text, in one line."""
    return f"# failed to get full definition text for {_one_line(type)}: {_one_line(str(reason))}"


def _one_line(text: str) -> str:
    return " ".join(text.split())


def _readable(type: str, source: str, registry: TypeRegistry) -> str:
    """Return ``source``, or the same types rewritten, or a comment. Raises ``TypesError``."""
    root = registry.definition(type)
    parts = [registry.definition(name) for name in registry.dependencies(type)]
    listed = [short_name(part.name) for part in parts]
    if (root.wire_fields or not root.constants) and all(
        is_readable(part, listed, root=part is root, text=registry.text(part.name)) for part in (root, *parts)
    ):
        return source
    plain = [_plainest(part) for part in (root, *parts)]
    for part in plain:
        if not is_readable(part, listed, root=part is plain[0], text=part.text()):
            return _failure(type, f"clients of rosbridge cannot read the names of the fields of {part.name}")
    first = plain[0].text()
    if not root.wire_fields:  # constants alone are no message to them
        first = "".join(f"# {line}\n" for line in first.splitlines())
    return first + "".join(f"{_RULE}\nMSG: {short_name(part.name)}\n{part.text()}" for part in plain[1:])


def _plainest(definition: Definition) -> Definition:
    """Return the definition without defaults, and without constants that clients trip over: only programs need them."""
    constants = tuple(_plain(c) for c in definition.constants)
    return replace(
        definition,
        fields=tuple(replace(field, default=None) for field in definition.wire_fields),
        constants=tuple(c for c in constants if _reads_constant(c, c.name, f"={c.text}")),
        source="",
    )


def _plain(constant: Constant) -> Constant:
    """Return the constant with its value as every parser reads it."""
    value = constant.value
    quoted = isinstance(value, str) and '"' + value.replace("\\", "\\\\").replace('"', '\\"') + '"'
    return replace(constant, text=quoted or str(value))


def is_readable(definition: Definition, listed: Sequence[str], *, root: bool, text: str) -> bool:
    """Return whether Lichtblick's parser reads ``text``, and as ``definition`` means it.

    ``listed`` are the types (``pkg/Name``) whose definitions follow the ``root``. Constants may be missing.
    """
    fields = iter(definition.wire_fields)
    constants = {constant.name: constant for constant in definition.constants}
    for raw in text.split("\n"):
        line = raw.strip()
        found = _LINE.match(line)
        if len(line.splitlines()) > 1:  # by other signs than clients know
            return False
        if not line or line.startswith("#"):
            continue
        if found is None:
            return False
        rest = found["rest"]
        if rest.lstrip().startswith("="):
            constant = constants.get(found["name"])
            if constant is None or not _reads_constant(constant, found["name"], rest):
                return False
        else:
            field = next(fields, None)
            if field is None or field.name != found["name"] or not _reads_field(field, rest):
                return False
            if field.type.is_message and not _finds(found["base"], field.type.base, definition.name, listed, root):
                return False
    return next(fields, None) is None


def _reads_constant(constant: Constant, name: str, rest: str) -> bool:
    if not _CONSTANT.match(name) or (constant.type in ("char", "byte") and str(constant.value).startswith("-")):
        return False
    return bool(_ASSIGNED[_kind(constant.type)].match(rest))


def _reads_field(field: Field, rest: str) -> bool:
    if not _FIELD.match(field.name):
        return False
    if field.default is None:
        return bool(_NOTHING.match(rest))
    return bool(_DEFAULT[_kind(field.type.base)].match(rest)) and _fits(field)


def _fits(field: Field) -> bool:
    values = field.default if isinstance(field.default, Iterable) and not isinstance(field.default, str) else ()
    return field.type.base != "char" or not any(isinstance(v, int) and v < 0 for v in (field.default, *values))


def _finds(written: str, meant: str, within: str, listed: Sequence[str], root: bool) -> bool:
    """Return whether the written name of a type leads to the type that is meant."""
    short = short_name(meant)
    if meant in TIMES and written in ("time", "duration", short, meant):
        return True
    if short not in listed:
        return False
    if "/" in written:
        return written == short
    if written == "Header":
        return meant == HEADER
    if root:
        return [name for name in listed if name.endswith(f"/{written}")] == [short]
    return f"{within.split('/')[0]}/{written}" == short


def _kind(base: str) -> str:
    if base in ("string", "wstring"):
        return "string"
    if base.startswith("float"):
        return "float"
    return {"bool": "bool", "int64": "int64", "uint64": "int64"}.get(base, "int")
