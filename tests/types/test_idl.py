"""Definitions in IDL."""

from __future__ import annotations

import pytest

from ropeway.errors import InvalidDefinition
from ropeway.types.definition import FieldType
from ropeway.types.idl import parse_idl

TEXT = """
module p { module msg {
  typedef double double__9[9];
  module A_Constants { const uint8 ONE = 1; };
  struct A { uint8 a; sequence<string<4>, 3> b; double__9 c; octet d; wstring e; boolean f; };
}; };
"""


def test_fields() -> None:
    """Fields of an IDL file come as those of a .msg."""
    found = {definition.name: definition for definition in parse_idl("p/msg/A", TEXT)}
    assert [(f.name, f.type) for f in found["p/msg/A"].fields] == [
        ("a", FieldType("uint8")),
        ("b", FieldType("string", 4, "sequence", 3)),
        ("c", FieldType("float64", 0, "array", 9)),
        ("d", FieldType("byte")),
        ("e", FieldType("wstring")),
        ("f", FieldType("bool")),
    ]
    assert [(c.name, c.value) for c in found["p/msg/A"].constants] == [("ONE", 1)]


def test_faults() -> None:
    """Text that is not IDL, or lacks the type, is refused with the name of the file."""
    with pytest.raises(InvalidDefinition, match=r"A\.idl: the definition of p/msg/A cannot be used"):
        parse_idl("p/msg/A", "struct {", file="A.idl")
    with pytest.raises(InvalidDefinition, match="it does not define this type"):
        parse_idl("p/msg/B", TEXT)
