"""The texts of definitions that web clients get."""

from __future__ import annotations

import re

import pytest
from hypothesis import given
from hypothesis import strategies as st
from rosbags.typesys import get_types_from_msg

from ropeway.errors import TypesError
from ropeway.types import TypeRegistry
from ropeway.types.definition_texts import Texts

_base = TypeRegistry()
RULE = "=" * 80


def text_of(text: str, name: str = "p/msg/A", **others: str) -> str:
    """What clients get of a type with this definition; ``others`` are more types of the package."""
    registry = TypeRegistry()
    for other, definition in others.items():
        registry.add_text(f"p/msg/{other}", definition)
    registry.add_text(name, text)
    return Texts(registry).of(name)


def test_all_known_types_come_as_they_are() -> None:
    """The text of every standard message is that of the registry, and a strict parser reads it."""
    texts = Texts(_base)
    for name in _base.names("msg"):
        if _base.definition(name).fields or not _base.definition(name).constants:
            assert texts.of(name) == _base.full_text(name)
            assert name in get_types_from_msg(texts.of(name), name)


@pytest.mark.parametrize(
    "text",
    [
        "float64 x\n",
        "# a comment\n\nint32 A=1\nint32 A_B = 0x10 # why\nstring C='it is'\nint64 d -5\nbool e true\nfloat32 f 1e5\n",
        'string<=5 a\nint8[3] b\nint8[<=3] c [1, 2]\nstring[] d\nstring e "x # y" # z\nuint8[2] f [1,2]\n',
        "std_msgs/Header header\ngeometry_msgs/Point[] points\nbuiltin_interfaces/Time t\n",
        "Header header\ntime t\nduration d\n",
        "byte A=7\nchar b 5\nwstring c\n",
        "",
        "# nothing but a comment\n",
    ],
)
def test_a_plain_text_stays_as_it_is(text: str) -> None:
    """What clients can read is not touched."""
    assert text_of(text).startswith(text)


@pytest.mark.parametrize(
    ("text", "written"),
    [
        ("geometry_msgs/msg/Vector3 v\n", "geometry_msgs/Vector3 v\n"),
        ("int64 A=0x10\nint64 b\n", "int64 A=16\nint64 b\n"),
        ("float64 a inf\n", "float64 a\n"),
        ("int32[] a []\n", "int32[] a\n"),
        ("string[] a ['x', 'y#z']\n", "string[] a\n"),
        ('string A=un"quoted\\n\nint32 b\n', 'string A="un\\"quoted\\\\n"\nint32 b\n'),
        ("int32 lowerCase=1\nint32 b\n", "int32 b\n"),
        ("char A=-1\nint32 b\n", "int32 b\n"),
        ("bool A=TRUE\nint32 b\n", "bool A=True\nint32 b\n"),
        ('@verbatim (language="comment")\nint32 b\n', "int32 b\n"),
        ("int32 a # x\u2028 int32 b\n", "int32 a\nint32 b\n"),
        ("int32 A=1\n", "# int32 A=1\n"),
    ],
)
def test_an_odd_text_is_written_anew(text: str, written: str) -> None:
    """Names of three parts, and values that the parsers of clients stumble over, are told plainly."""
    assert text_of(text).split(RULE)[0] == written


def test_types_of_the_same_name() -> None:
    """Where a short name could mean two types, each gets its package."""
    assert text_of("Point a\ngeometry_msgs/Point b\n", Point="int8 x\n").startswith(
        "p/Point a\ngeometry_msgs/Point b\n"
    )
    assert text_of("Header a\n", Header="int8 x\n").startswith("p/Header a\n")


def test_the_sequence_number_of_ros_1() -> None:
    """The header of ROS 1 comes without the number that ROS 2 does not send."""
    registry = TypeRegistry("noetic")
    text = Texts(registry).of("std_msgs/msg/Header")
    assert "seq" not in text
    assert "string frame_id" in text


@pytest.mark.parametrize("field", ["K", "camelCase", "a__b", "a_", "x" * 40 + "Y"])
def test_names_that_nobody_reads(field: str) -> None:
    """A field whose name the parsers refuse costs its type the text, and only this type."""
    for text in (text_of(f"float64 {field}\n"), text_of("B b\n", B=f"float64 {field}\n")):
        assert text.startswith("# failed to get full definition text for p/msg/A: clients")
        assert "\n" not in text


def test_a_type_is_learned() -> None:
    """A text that was missing is there as soon as the definition is."""
    registry = TypeRegistry()
    registry.add_text("q/msg/Outer", "q/Inner i\n")
    texts = Texts(registry)
    for name in ("q/msg/Outer", "q/msg/Inner"):
        assert texts.of(name).startswith(f"# failed to get full definition text for {name}: ")
        assert "q/msg/Inner is not known" in texts.of(name)
    registry.add_text("q/msg/Inner", "int8 x\n")
    assert texts.of("q/msg/Inner") == "int8 x\n"
    assert texts.of("q/msg/Outer") == f"q/Inner i\n{RULE}\nMSG: q/Inner\nint8 x\n"


def test_a_type_is_replaced() -> None:
    """A text changes with the definition of a type that it contains."""
    registry = TypeRegistry()
    texts = Texts(registry)
    before = texts.of("geometry_msgs/msg/Pose")
    registry.add_text("geometry_msgs/msg/Point", "float32 x\n", replace=True)
    assert texts.of("geometry_msgs/msg/Pose") != before
    assert "float32 x" in texts.of("geometry_msgs/msg/Pose")


def test_bad_names() -> None:
    """Whatever a topic calls its type, the answer is one line of comment."""
    texts = Texts(_base)
    for name in ("", "x", "a/b/c/d", "a/msg/b\nint32 c", "std_msgs/msg/", "a" * 5000):
        assert re.fullmatch(r"# failed to get full definition text for [^\n]*", texts.of(name))


def test_the_number_of_texts_is_bounded() -> None:
    """Types that come and go are not kept for ever."""
    texts = Texts(_base)
    for number in range(9000):
        texts.of(f"gone/msg/T{number}")
    assert len(texts._made) <= 4096


_WORDS = (
    "int8 int64 float64 bool string char byte Header B p/B std_msgs/msg/Header time [] [2] [<=3] <=4 a b_c D E_F g__"
)
_VALUES = ["=", "1", "-1", "0x1", "1e5", "nan", "true", "'x'", '"y # z"', "[1,2]", "[", "]", "#", "@", "\\"]
_pieces = st.sampled_from([*_WORDS.split(), *_VALUES, "\n", "\n", " ", "\t", "\r\n", "\x0b", "\u2028"])
_READABLE = re.compile(
    r"(#.*|[A-Za-z0-9_/]+(<=\d+)?(\[(<=)?\d*\])?\s+[A-Za-z][A-Za-z0-9_]*(\s*=.*|\s+[^=].*|\s*(#.*)?))?"
)


@given(st.lists(_pieces, max_size=24).map(" ".join))
def test_whatever_a_definition_holds(text: str) -> None:
    """Every definition that can be read gives a text of lines that are fields, constants, comments or rules."""
    try:
        made = text_of(text, B="int8 x\n")
    except TypesError:
        return
    for line in made.split("\n"):
        if not line.startswith(("MSG: ", RULE)):
            assert _READABLE.fullmatch(line.strip()), line
