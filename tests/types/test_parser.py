"""The reader of .msg, .srv and .action texts."""

from __future__ import annotations

import contextlib

import pytest
from hypothesis import given
from hypothesis import strategies as st

from ropeway.errors import InvalidDefinition
from ropeway.types.definition import Field, FieldType
from ropeway.types.parser import parse_interface, parse_msg, parse_sections


def fields(text: str) -> tuple[Field, ...]:
    """The fields of a message with this definition."""
    return parse_msg("pkg/msg/Name", text).fields


def test_types_of_fields() -> None:
    """Every form of a type is understood."""
    text = """
    # a comment
    uint8 a            # another
    string<=5[<=3] b
    float64[9] c
    Other d
    other_pkg/Thing[] e
    other_pkg/msg/Thing f
    wstring<=2 g
    Header h
    time i
    duration[] j
    """
    assert [(f.name, f.type.spelled()) for f in fields(text)] == [
        ("a", "uint8"),
        ("b", "string<=5[<=3]"),
        ("c", "float64[9]"),
        ("d", "pkg/Other"),
        ("e", "other_pkg/Thing[]"),
        ("f", "other_pkg/Thing"),
        ("g", "wstring<=2"),
        ("h", "std_msgs/Header"),
        ("i", "builtin_interfaces/Time"),
        ("j", "builtin_interfaces/Duration[]"),
    ]


def test_own_header() -> None:
    """A package's own Header goes before std_msgs/Header."""
    definition = parse_msg("pkg/msg/Name", "Header h\n", siblings={"pkg/msg/Header"})
    assert definition.fields[0].type == FieldType("pkg/msg/Header")


def test_defaults() -> None:
    """Default values come as Python values."""
    text = (
        'string a "x # y"\nint32 b -7\nbool c true\nfloat32 d 1e3\nstring[] e ["p, q", \'r\']\n'
        "uint8 f 0x10\nint8[2] g [1, -1]\nstring h 'it\\'s'\nint16 i 010\n"
    )
    assert [f.default for f in fields(text)] == ["x # y", -7, True, 1000.0, ["p, q", "r"], 16, [1, -1], "it's", 10]


def test_constants() -> None:
    """Constants keep their value and how it was written."""
    definition = parse_msg(
        "p/msg/N", 'uint8 A=0x0f\nstring B = "x # y" # why\nbool C=True\nfloat64 D=.5\nstring E=a b # c\n'
    )
    assert [(c.name, c.value) for c in definition.constants] == [
        ("A", 15),
        ("B", "x # y"),
        ("C", True),
        ("D", 0.5),
        ("E", "a b"),
    ]
    assert definition.constants[0].text == "0x0f"
    assert definition.constants[4].text == "a b # c"


@pytest.mark.parametrize(
    ("text", "reason"),
    [
        ("int32", "line 1: 'int32' is neither a field nor a constant"),
        ("\nint32 a\nwhat is this", "line 3: a field of a message type has no default"),
        ("uint8 a 256", "line 1: 256 is not in the range of uint8, 0 to 255"),
        ("uint8 a x", "line 1: x is not a value of uint8"),
        ("bool a 2", "line 1: 2 is not a bool"),
        ("int32<=4 a", "line 1: int32 cannot have an upper bound; only string and wstring can"),
        ("Thing<=4 a", "line 1: Thing cannot have an upper bound"),
        ("string<=2 a 'abc'", "line 1: 'abc' is longer than 2"),
        ("int8[2] a [1]", r"line 1: 1 default values do not fit int8\[2\]"),
        ("int8[2] a 1", r"line 1: the default of an array is written"),
        ("int8[0] a", "line 1: 0 is not the size of an array"),
        ("int8[999999999] a", "line 1: 999999999 is not the size of an array"),
        ("Thing A=1", "line 1: the constant A must be of a primitive type"),
        ("int8[2] A=1", "line 1: the constant A must be of a primitive type"),
        ("int8 a\nint8 a", "a is defined twice"),
        ("a/b/c/d e", "line 1: 'a/b/c/d' is not a type name"),
    ],
)
def test_faults(text: str, reason: str) -> None:
    """A fault is told with its line."""
    with pytest.raises(InvalidDefinition, match=reason):
        fields(text)


def test_service() -> None:
    """A service gives request, response and event."""
    parts = parse_interface("p/srv/Add", "int64 a\n---\nint64 sum\n")
    assert [part.name for part in parts] == ["p/srv/Add_Request", "p/srv/Add_Response", "p/srv/Add_Event"]
    assert [f.type.spelled() for f in parts[2].fields] == [
        "service_msgs/ServiceEventInfo",
        "p/srv/Add_Request[<=1]",
        "p/srv/Add_Response[<=1]",
    ]


def test_action() -> None:
    """An action gives its three parts and all that ROS 2 derives from it."""
    parts = {part.name.split("/")[2]: part for part in parse_interface("p/action/Go", "int8 a\n---\nint8 b\n---\n")}
    assert list(parts) == [
        "Go_Goal",
        "Go_Result",
        "Go_Feedback",
        "Go_SendGoal_Request",
        "Go_SendGoal_Response",
        "Go_GetResult_Request",
        "Go_GetResult_Response",
        "Go_FeedbackMessage",
        "Go_SendGoal_Event",
        "Go_GetResult_Event",
    ]
    assert [(f.name, f.type.base) for f in parts["Go_GetResult_Response"].fields] == [
        ("status", "int8"),
        ("result", "p/action/Go_Result"),
    ]


def test_wrong_number_of_parts() -> None:
    """A service or action with too few or too many parts is refused."""
    with pytest.raises(InvalidDefinition, match="expected request --- response, found 1 part"):
        parse_interface("p/srv/Add", "int64 a\n")
    with pytest.raises(InvalidDefinition, match="expected goal --- result --- feedback, found 2 parts"):
        parse_interface("p/action/Go", "int64 a\n---\n")


@given(st.integers(3, 9), st.sampled_from(["", " ", "\t", "# why", " # why", " and more", "\r"]))
def test_separators(length: int, behind: str) -> None:
    """A separator is a line that begins with three dashes or more once its comment is gone, as ROS 1 reads it."""
    line = "-" * length + behind
    request, response, _ = parse_interface("p/srv/Add", f"int8 a # ---\n# {line}\n{line}\nint8 b\n")
    assert [f.name for f in (*request.fields, *response.fields)] == ["a", "b"]
    parts = parse_interface("p/action/Go", f"int8 a\n{line}\n{line}\nint8 c\n")
    assert [[f.name for f in part.fields] for part in parts[:3]] == [["a"], [], ["c"]]


def test_faults_of_parts_have_the_line_of_the_file() -> None:
    """A fault in the second part of a service is told with its line in the file."""
    with pytest.raises(InvalidDefinition, match="line 4: "):
        parse_interface("p/srv/Add", "int8 a\nint8 b\n---\nwhat\n")


def test_a_byte_may_be_signed() -> None:
    """A byte is signed in ROS 1 and unsigned in ROS 2: both spellings of the same bits are taken."""
    definition = parse_msg("p/msg/N", "byte ALL=-1\nbyte MOST=255\nbyte LEAST=-128\nbyte a -5\n")
    assert [(c.value, c.text) for c in definition.constants] == [(255, "-1"), (255, "255"), (128, "-128")]
    assert definition.fields[0].default == 251
    with pytest.raises(InvalidDefinition, match="-129 is not in the range of byte"):
        parse_msg("p/msg/N", "byte A=-129\n")


def test_odd_signs_in_comments_end_no_line() -> None:
    """A form feed or another sign that Unicode counts as the end of a line does not end a comment."""
    assert [f.name for f in fields("int8 a # one\x0ctwo\x85three\u2028four\rint8 b")] == ["a", "b"]


def test_sections() -> None:
    """A concatenated text comes apart at its headings."""
    rule = "=" * 80
    text = f"A a\n{rule}\nMSG: p/A\nB b\n\n{rule}\r\nMSG: q/B\r\n{rule}\nIDL: q/msg/C\nint8 c"
    assert list(parse_sections("p/msg/Main", text)) == [
        ("p/msg/Main", "A a\n"),
        ("p/msg/A", "B b\n\n"),
        ("q/msg/B", ""),
        ("q/msg/C", "int8 c"),
    ]
    with pytest.raises(InvalidDefinition, match="is not a type name"):
        list(parse_sections("p/msg/Main", f"{rule}\nMSG: nonsense\n"))


@given(st.text(alphabet=st.sampled_from("ab1 \n\t#=[]<>\"'\\-/,.:int8stringMSGHeader"), max_size=80))
def test_any_text(text: str) -> None:
    """Whatever the text, it is a definition or an InvalidDefinition."""
    for name in ("p/msg/N", "p/srv/N", "p/action/N"):
        with contextlib.suppress(InvalidDefinition):
            for section, body in parse_sections(name, text):
                parse_interface(section, body)
