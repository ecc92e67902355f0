"""Reads ``.idl`` files: those that ``rosidl_adapter`` writes, and those of packages that are written in IDL.

Understands what ROS 2's own parser does (modules, structures, constants, typedefs, annotations), and beyond it
enumerations and bitmasks as fields, constant expressions and several structures in one file. What no message can
hold (unions, maps, inheritance, sequences of sequences) is refused with its line.
"""

from __future__ import annotations

import ast
from typing import Final, TypeAlias

from ropeway.errors import InvalidDefinition, InvalidTypeName
from ropeway.types.definition import FILLER, KINDS, Constant, Definition, Field, FieldType, canonical_name
from ropeway.types.idl_expressions import Expressions, Value
from ropeway.types.idl_tokens import IdlError, tokens
from ropeway.types.parser import LARGEST_ARRAY, PARTS, RANGES, derived

__all__ = ["parse_idl"]

Path: TypeAlias = tuple[str, ...]

_SIMPLE: Final = {
    "boolean": "bool",
    "octet": "byte",
    "char": "char",
    "short": "int16",
    "long": "int32",
    "float": "float32",
    "double": "float64",
    **{name: name for name in RANGES if name not in ("byte", "char")},
}
_REFUSED: Final = ("union", "map", "fixed", "any", "wchar", "native", "interface", "valuetype", "bitset", "set")
_CONSTANTS: Final = "_Constants"
_DEEPEST_MODULE: Final = 16


def parse_idl(name: str, text: str, *, file: str = "") -> list[Definition]:
    """Return the definitions in ``text``, including the interface ``name`` and everything that ROS 2 derives from it.

    Raises ``InvalidDefinition`` with the number of the line.
    """
    try:
        found = _Reader(text).read()
        wanted = [f"{name}{end}" for end in PARTS[name.split("/")[1]]]
        missing = [part for part in wanted if part not in found]
        if missing and name not in found:
            raise InvalidDefinition(name, f"it does not define this type (no structure {missing[0]})", file=file)
        for definition in found.values():
            definition.check()
    except IdlError as error:
        raise InvalidDefinition(name, str(error), file=file) from None
    except RecursionError:
        raise InvalidDefinition(name, "its types or expressions are nested too deep", file=file) from None
    except InvalidDefinition as error:
        raise InvalidDefinition(error.name, error.reason, file=file) from None
    return [*found.values(), *(() if missing else derived(name))]


class _Reader(Expressions):
    """Reads declarations one after another; ``known`` has every name declared so far by its path."""

    def __init__(self, text: str) -> None:
        super().__init__(list(tokens(text)))
        self.known: dict[Path, FieldType | Value] = {}
        self.structs: dict[Path, tuple[Field, ...]] = {}
        self.constants: dict[Path, list[Constant]] = {}

    def read(self) -> dict[str, Definition]:
        """Read the text and return its messages by full name."""
        while self.token.kind != "end":
            self.declaration()
        return {
            self.type_name(path): Definition(
                self.type_name(path), fields, tuple(self.constants.get((*path[:-1], path[-1] + _CONSTANTS), ()))
            )
            for path, fields in self.structs.items()
        }

    def declaration(self) -> None:
        """Read a module, structure, constant, typedef, enumeration or bitmask."""
        notes = self.annotations()
        word = self.word("a declaration")
        if word == "module":
            self.module()
        elif word == "struct":
            self.struct()
        elif word == "const":
            self.constant()
        elif word == "typedef":
            self.typedef()
        elif word == "enum":
            self.enum(notes)
        elif word == "bitmask":
            self.bitmask(notes)
        else:
            raise self.fault(f"{word} is not supported in messages", back=1)
        self.expect(";")

    def module(self) -> None:
        """Read the declarations of a module."""
        self.scope = (*self.scope, self.word("the name of a module"))
        if len(self.scope) > _DEEPEST_MODULE:
            raise self.fault(f"more than {_DEEPEST_MODULE} modules stand one in another")
        self.expect("{")
        while not self.take("}"):
            self.declaration()
        self.scope = self.scope[:-1]

    def struct(self) -> None:
        """Read a structure, or that there will be one."""
        path = (*self.scope, self.word("the name of a structure"))
        self.type_name(path)
        self.known[path] = FieldType(self.type_name(path))
        if self.token.text == ";":
            return
        if self.token.text == ":":
            raise self.fault("a structure that inherits another is not supported in messages")
        if path in self.structs:
            raise self.fault(f"{path[-1]} is defined twice", back=1)
        self.expect("{")
        fields: list[Field] = []
        self.scope = (*self.scope, path[-1] + _CONSTANTS)  # its own constants may be sizes and defaults
        while not self.take("}"):
            notes = self.annotations()
            type = self.type_spec()
            while True:
                name, declared = self.declarator(type)
                default = notes.get("default")
                fields.append(Field(name, declared, None if default is None else self.default(declared, default)))
                if not self.take(","):
                    break
            self.expect(";")
        self.scope = self.scope[:-1]
        self.structs[path] = () if [field.name for field in fields] == [FILLER] else tuple(fields)

    def constant(self) -> None:
        """Read a constant. Those in the module ``NAME_Constants`` are the message's."""
        type = self.type_spec()
        if type.kind != "scalar" or type.is_message:
            raise self.fault("a constant must be of a primitive type", back=1)
        name = self.word("the name of a constant")
        self.expect("=")
        value = self.fitting(type, self.expression())
        path = (*self.scope, name)
        if path in self.known:
            raise self.fault(f"{name} is defined twice", back=1)
        self.declare(value, path)
        text = str(value).lower() if isinstance(value, bool) else str(value)
        self.constants.setdefault(self.scope, []).append(Constant(name, type.base, value, text))

    def declare(self, what: FieldType | Value, *paths: Path) -> None:
        """Make something known under each of its paths."""
        for path in paths:
            self.known[path] = what

    def typedef(self) -> None:
        """Read other names of a type."""
        type = self.type_spec()
        while True:
            name, declared = self.declarator(type)
            self.declare(declared, (*self.scope, name))
            if not self.take(","):
                break

    def enum(self, notes: dict[str, Value]) -> None:
        """Read an enumeration, whose values CDR writes as numbers."""
        path = (*self.scope, self.word("the name of an enumeration"))
        self.known[path] = FieldType(self.bits(notes, 32))
        self.expect("{")
        number = 0
        while True:
            value = self.annotations().get("value", number)
            if isinstance(value, (str, float)):
                raise self.fault("the value of an enumerator is a whole number")
            name = self.word("an enumerator")
            self.declare(value, (*self.scope, name), (*path, name))
            number = value + 1
            if not self.take(","):
                break
        self.expect("}")

    def bitmask(self, notes: dict[str, Value]) -> None:
        """Read a bitmask, which CDR writes as a number of at least so many bits."""
        path = (*self.scope, self.word("the name of a bitmask"))
        self.known[path] = FieldType(self.bits(notes, 32))
        self.expect("{")
        bit = 0
        while True:
            position = self.annotations().get("position", bit)
            if not isinstance(position, int) or not 0 <= position < 64:
                raise self.fault("the position of a bit is from 0 to 63")
            name = self.word("a bit")
            self.declare(1 << position, (*self.scope, name), (*path, name))
            bit = position + 1
            if not self.take(","):
                break
        self.expect("}")

    def bits(self, notes: dict[str, Value], usual: int) -> str:
        """Return the unsigned type that holds as many bits as ``@bit_bound`` says."""
        count = notes.get("bit_bound", usual)
        for size in (8, 16, 32, 64):
            if isinstance(count, int) and 0 < count <= size:
                return f"uint{size}"
        raise self.fault("@bit_bound is from 1 to 64")

    def declarator(self, type: FieldType) -> tuple[str, FieldType]:
        """Read the name of a field or type, and how many of it there are."""
        name = self.word("a name").removeprefix("_")  # an underscore only marks a name that is a word of IDL
        if not self.take("["):
            return name, type
        size = self.size("]")
        self.expect("]")
        if type.kind != "scalar" or self.token.text == "[":
            raise self.fault("an array of arrays or sequences is not supported in messages")
        return name, FieldType(type.base, type.bound, "array", size)

    def type_spec(self) -> FieldType:
        """Read a type."""
        if self.token.text == "::":
            return self.named_type()
        word = self.word("a type")
        if word == "unsigned":
            kind = self.word("short or long")
            if kind not in ("short", "long"):
                raise self.fault(f"unsigned {kind} is not a type", back=1)
            return FieldType("u" + (_SIMPLE[kind] if kind == "short" or not self.take("long") else "int64"))
        if word == "long":
            if self.token.text == "double":
                raise self.fault("long double is not supported in messages")
            return FieldType("int64" if self.take("long") else "int32")
        if word in _SIMPLE:
            return FieldType(_SIMPLE[word])
        if word in ("string", "wstring"):
            bound = 0
            if self.take("<"):
                bound = self.size(">")
                self.expect(">")
            return FieldType(word, bound)
        if word == "sequence":
            return self.sequence()
        if word in _REFUSED:
            raise self.fault(f"{word} is not supported in messages", back=1)
        self.position -= 1
        return self.named_type()

    def sequence(self) -> FieldType:
        """Read what a sequence is made of."""
        self.expect("<")
        if self.token.text == "sequence":
            raise self.fault("a sequence of arrays or sequences is not supported in messages")
        inner = self.type_spec()
        if inner.kind != "scalar":
            raise self.fault("a sequence of arrays or sequences is not supported in messages", back=1)
        size = self.size(">") if self.take(",") else 0
        self.expect(">")
        return FieldType(inner.base, inner.bound, "sequence", size)

    def named_type(self) -> FieldType:
        """Read the name of a type that this file declares, or that another package does."""
        start = self.position
        path = self.scoped_name()
        found = self.look_up(path)
        if isinstance(found, FieldType):
            return found
        parts = path[1:] if path[0] == "" else path
        if found is None and len(parts) > 1:
            return FieldType(self.type_name(parts))
        line = self.tokens[start].line
        raise IdlError(line, f"{'::'.join(parts)} is not a type declared here; write PACKAGE::msg::{parts[-1]}")

    def type_name(self, path: Path) -> str:
        """Return the full name of the message at ``path``."""
        try:
            if len(path) == 2 and path[0] in KINDS and len(self.scope) > 1:
                path = (self.scope[0], *path)
            if len(path) < 2:
                raise InvalidTypeName(path[-1])
            return canonical_name("/".join(path))
        except InvalidTypeName:
            raise self.fault(
                f"{'::'.join(path)} is not in a module PACKAGE and, in it, msg, srv or action", back=1
            ) from None

    def size(self, closing: str) -> int:
        """Read how long a string, sequence or array is."""
        value = self.expression(closing)
        if isinstance(value, bool) or not isinstance(value, int) or not 0 < value <= LARGEST_ARRAY:
            raise self.fault(f"{value} is not a size", back=1)
        return value

    def default(self, type: FieldType, value: Value) -> object:
        """Return the default of a field; for an array it is a text with a Python tuple, as ROS 2 writes it."""
        if type.is_message:
            raise self.fault("a field of a message type has no default", back=1)
        if type.kind == "scalar":
            return self.fitting(type, value)
        try:
            items = ast.literal_eval(value) if isinstance(value, str) else None
        except (ValueError, SyntaxError, MemoryError, RecursionError):
            items = None
        if not isinstance(items, (tuple, list)):
            raise self.fault('the default of an array is written "(a, b)"', back=1)
        if (type.kind == "array" and len(items) != type.size) or (type.size and len(items) > type.size):
            raise self.fault(f"{len(items)} default values do not fit {type.spelled()}", back=1)
        return [self.fitting(FieldType(type.base, type.bound), item) for item in items]

    def fitting(self, type: FieldType, value: object) -> bool | int | float | str:
        """Return ``value`` converted to ``type``."""
        base = type.base
        if base in ("string", "wstring") and isinstance(value, str):
            units = len(value.encode("utf-8", "replace")) if base == "string" else len(value)
            if not type.bound or units <= type.bound:
                return value
        elif base == "bool" and isinstance(value, int) and value in (0, 1):
            return bool(value)
        elif base in ("float32", "float64") and isinstance(value, (int, float)) and not isinstance(value, bool):
            return float(value)
        elif base in RANGES and isinstance(value, int):
            low, high = RANGES[base]
            if low <= value <= high:
                return int(value)
        raise self.fault(f"{value!r:.60} is not a value of {type.spelled()}", back=1)
