"""Names, types and texts of definitions."""

from __future__ import annotations

import pytest

from ropeway.errors import InvalidDefinition, InvalidTypeName
from ropeway.types.definition import Constant, Definition, Field, FieldType, canonical_name, short_name


@pytest.mark.parametrize(
    "given",
    ["std_msgs/String", "std_msgs/msg/String", "/std_msgs//String/", "std_msgs.msg.String", "//std_msgs/msg//String"],
)
def test_spellings_of_a_name(given: str) -> None:
    """All spellings of a type name give the full one."""
    assert canonical_name(given) == "std_msgs/msg/String"


def test_kind_fills_the_middle() -> None:
    """The kind is used where the name has no middle part, and only there."""
    assert canonical_name("std_srvs/SetBool", "srv") == "std_srvs/srv/SetBool"
    assert canonical_name("std_srvs/srv/SetBool", "msg") == "std_srvs/srv/SetBool"
    assert short_name("std_srvs/srv/SetBool") == "std_srvs/SetBool"


@pytest.mark.parametrize(
    "given", ["", "String", "a/b/c/d", "a/what/B", "a/B c", "1a/B", "a/B\n", "a/é", "a" * 5000 + "/B", None, 3, ["a/B"]]
)
def test_bad_names(given: object) -> None:
    """What is not a type name is refused."""
    with pytest.raises(InvalidTypeName):
        canonical_name(given)  # type: ignore[arg-type]


def test_text_of_a_type() -> None:
    """A field type is spelled as in a .msg file."""
    assert FieldType("string", 5, "sequence", 3).spelled() == "string<=5[<=3]"
    assert FieldType("float64", kind="array", size=9).spelled() == "float64[9]"
    assert FieldType("std_msgs/msg/Header", kind="sequence").spelled() == "std_msgs/Header[]"


def test_written_text() -> None:
    """A definition without source is written from constants, fields and defaults."""
    made = Definition(
        "a/msg/B",
        (
            Field("x", FieldType("string"), 'say "hi"'),
            Field("y", FieldType("bool", kind="array", size=2), [True, False]),
        ),
        (Constant("ONE", "uint8", 1, "0x01"),),
    )
    assert made.text() == 'uint8 ONE=0x01\nstring x "say \\"hi\\""\nbool[2] y [true, false]\n'


def test_layouts() -> None:
    """Layouts are equal if names and types are; char is uint8, and a header's seq does not count."""
    uint8, char = Field("a", FieldType("uint8")), Field("a", FieldType("char"))
    assert Definition("p/msg/A", (uint8,)).same_layout(Definition("p/msg/A", (char,)))
    assert not Definition("p/msg/A", (uint8,)).same_layout(Definition("p/msg/A", (Field("b", FieldType("uint8")),)))
    assert not Definition("p/msg/A", (uint8,)).same_layout(Definition("p/msg/A", ()))
    header = "std_msgs/msg/Header"
    seq, frame = Field("seq", FieldType("uint32")), Field("frame_id", FieldType("string"))
    assert Definition(header, (seq, frame)).same_layout(Definition(header, (frame,)))


def test_names_once() -> None:
    """A name stands for one field or constant only."""
    with pytest.raises(InvalidDefinition, match="x is defined twice"):
        Definition("a/msg/B", (Field("x", FieldType("int8")),), (Constant("x", "int8", 1, "1"),)).check()
