"""Definitions in IDL."""

from __future__ import annotations

import contextlib
from dataclasses import replace

import pytest
from hypothesis import given
from hypothesis import strategies as st

from ropeway.errors import InvalidDefinition
from ropeway.types.definition import Definition, FieldType
from ropeway.types.idl import parse_idl
from ropeway.types.parser import PARTS, parse_interface

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


def message(body: str, before: str = "") -> Definition:
    """The message p/msg/A of these fields."""
    text = f"{before}\nmodule p {{ module msg {{ struct A {{ {body} }}; }}; }};"
    return next(found for found in parse_idl("p/msg/A", text) if found.name == "p/msg/A")


def test_as_rosidl_adapter_writes_it() -> None:
    """Includes, comments, annotations, typedefs of arrays, defaults and the member of an empty structure are read."""
    text = """
    // generated from rosidl_adapter/resource/msg.idl.em
    #include "geometry_msgs/msg/Point.idl"
    #include <p/msg/Other.idl>
    module p {
      module msg {
        typedef geometry_msgs::msg::Point geometry_msgs__msg__Point;
        typedef geometry_msgs__msg__Point geometry_msgs__msg__Point__1[1];
        typedef int32 int32__3[3];
        module A_Constants {
          @verbatim (language="comment", text="why; } \\"that\\"" "\\n" "and (more")
          const string NAME = "a" "b";
          const octet LOW = 255;
          const boolean ON = TRUE;
          const float HALF = -0.5;
        };
        @verbatim (language="comment", text="")
        struct A {
          @default (value="(1, -2, 3)") @unit (value="m")
          int32__3 numbers;
          @default (value="('x, y', 'it\\\\'s')")
          sequence<string> texts;
          @default (value=TRUE) boolean on;
          @default (value=1e-3) double far, near;
          @default (value="say \\"hi\\"") string<32> word;
          geometry_msgs__msg__Point__1 points;
          sequence<sequence_holder::msg::B> others;
          sequence<string<4>> short_texts;
          p::msg::Other other;
          @key @range (min=-10, max=10) @transfer_mode(SHMEM_REF) unsigned long long _module;
        };
        struct B { uint8 structure_needs_at_least_one_member; };
      };
    };
    """
    found = {definition.name: definition for definition in parse_idl("p/msg/A", text)}
    assert [(f.type.spelled(), f.name, f.default) for f in found["p/msg/A"].fields] == [
        ("int32[3]", "numbers", [1, -2, 3]),
        ("string[]", "texts", ["x, y", "it's"]),
        ("bool", "on", True),
        ("float64", "far", 0.001),
        ("float64", "near", 0.001),
        ("string<=32", "word", 'say "hi"'),
        ("geometry_msgs/Point[1]", "points", None),
        ("sequence_holder/B[]", "others", None),
        ("string<=4[]", "short_texts", None),
        ("p/Other", "other", None),
        ("uint64", "module", None),
    ]
    assert [(c.type, c.name, c.value) for c in found["p/msg/A"].constants] == [
        ("string", "NAME", "ab"),
        ("byte", "LOW", 255),
        ("bool", "ON", True),
        ("float32", "HALF", -0.5),
    ]
    assert found["p/msg/B"].fields == ()


def test_constants_are_computed() -> None:
    """Sizes, defaults and constants may be expressions of other constants."""
    before = "const long N = (1 << 3) | 0x10 >> 4; module q { const short M = -~1; };"
    found = message(
        "@default(value=N * 2 - 010 / 4 % 3) long a; string<N + q::M> b; sequence<long, N> c; octet d[2*2];", before
    )
    assert [(f.type.spelled(), f.default) for f in found.fields] == [
        ("int32", 16),
        ("string<=11", None),
        ("int32[<=9]", None),
        ("byte[4]", None),
    ]


def test_enumerations_and_bitmasks() -> None:
    """An enumeration or bitmask as a field is the number that CDR writes, and its names are constants."""
    before = (
        "module p { module msg { enum Color { RED, @value(5) GREEN, BLUE };"
        " @bit_bound(8) bitmask Flags { A, @position(4) B }; }; };"
    )
    found = message("@default(value=BLUE) Color color; @default(value=Flags::B) p::msg::Flags flags;", before)
    assert [(f.type.base, f.default) for f in found.fields] == [("uint32", 6), ("uint8", 16)]


@pytest.mark.parametrize("kind", ["srv", "action"])
def test_services_and_actions(kind: str) -> None:
    """A service or action in IDL has the same parts as one in its own format."""
    ends = PARTS[kind]
    structs = "".join(f"struct Go{end} {{ long a; }};" for end in ends)
    found = parse_idl(f"p/{kind}/Go", f"module p {{ module {kind} {{ {structs} }}; }};")
    assert found == [
        replace(each, source="") for each in parse_interface(f"p/{kind}/Go", "---\n".join(["int32 a\n"] * len(ends)))
    ]


@pytest.mark.parametrize(
    ("body", "reason"),
    [
        ("long double a;", "line 2: long double is not supported"),
        ("\n\nmap<long, long> a;", "line 4: map is not supported"),
        ("long a", "line 2: expected ';', found '}'"),
        ("flot a;", "line 2: flot is not a type declared here"),
        ("sequence<sequence<long>> a;", "line 2: a sequence of arrays or sequences is not supported"),
        ("sequence<" * 5000 + "long", "line 2: a sequence of arrays or sequences is not supported"),
        ("long a[" + "-" * 5000 + "1];", "line 2: the expression is nested too deeply"),
        ("long a[" + "1" * 5000 + "];", "line 2: 1+ is not a number"),
        ("long a[2][2];", "line 2: an array of arrays or sequences"),
        ("long a[0];", "line 2: 0 is not a size"),
        ("long a[1 / 0];", "line 2: the expression has no value"),
        ("long a[1 << 64];", "line 2: 64 is not a number of bits"),
        ("long a[N];", "line 2: N is not a known constant"),
        ("long a[" + "(" * 99 + "1];", "line 2: the expression is nested too deeply"),
        ('@default(value="x") long a;', "line 2: 'x' is not a value of int32"),
        ("@default(value=1) p::msg::B a;", "line 2: a field of a message type has no default"),
        ('@default(value="(1, 2)") sequence<long, 1> a;', r"line 2: 2 default values do not fit"),
        ("@default(value=300) uint8 a;", "line 2: 300 is not a value of uint8"),
        ("long a; $", "line 2: .* is not IDL"),
        ("long a; long a;", "a is defined twice"),
        ("\n#if 1\nlong a;\n#endif", "line 3: '#if 1'"),
    ],
)
def test_what_is_no_message(body: str, reason: str) -> None:
    """What no message can hold is refused with its line."""
    with pytest.raises(InvalidDefinition, match=reason):
        message(body)


@given(
    st.lists(
        st.sampled_from(
            [
                *"{}()<>[];:,=@1\"'#\\",
                "::",
                "\n",
                " ",
                "module",
                "struct",
                "const",
                "enum",
                "typedef",
                "long",
                "sequence",
                "A",
                "p",
                "msg",
            ]
        ),
        max_size=40,
    )
)
def test_any_text(words: list[str]) -> None:
    """Whatever the text, it is read or refused as an InvalidDefinition."""
    for text in (" ".join(words), f"module p {{ module msg {{ struct A {{ {' '.join(words)} }}; }}; }};"):
        with contextlib.suppress(InvalidDefinition):
            parse_idl("p/msg/A", text)


def test_faults() -> None:
    """Text that is not IDL, or lacks the type, is refused with the name of the file."""
    with pytest.raises(InvalidDefinition, match=r"A\.idl: the definition of p/msg/A cannot be used"):
        parse_idl("p/msg/A", "struct {", file="A.idl")
    with pytest.raises(InvalidDefinition, match="it does not define this type"):
        parse_idl("p/msg/B", TEXT)
