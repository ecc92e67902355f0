from __future__ import annotations

import json
import math

import pytest
from hypothesis import given
from hypothesis import strategies as st

from ropeway.errors import TypesError
from ropeway.types import TypeRegistry
from ropeway.types.forms import (
    FAILURES,
    RAW_TYPES,
    TWIST,
    AngleForm,
    CdrForm,
    CodesForm,
    FloatsForm,
    Form,
    JsonForm,
    RawForm,
    TextForm,
    default_form,
    make_form,
)

registry = TypeRegistry()
twists = registry.codec("geometry_msgs/msg/Twist")
CODES = {"0": {"linear.x": 0.2}, "1": {"linear.x": -0.2}, "2": {"angular.z": 0.5}, "3": {"angular.z": -0.5}, "4": {}}


def twist(x: float = 0.0, z: float = 0.0) -> bytes:
    return twists.encode({"linear": {"x": x}, "angular": {"z": z}})


FINITE = st.floats(allow_nan=False, allow_infinity=False)


@given(st.lists(FINITE, min_size=6, max_size=6))
def test_floats(numbers: list[float]) -> None:
    """Six numbers become a Twist and the same six numbers again."""
    form = FloatsForm(twists, TWIST)
    ((delay, cdr),) = form.messages(",".join(map(repr, numbers)).encode())
    assert delay == 0.0
    assert [float(part) for part in form.text(cdr).decode().split(",")] == numbers


@pytest.mark.parametrize("data", [b"", b"1,2,3,4,5", b"1,2,3,4,5,6,7", b"a,b,c,d,e,f", b"nan,0,0,0,0,0", b"\xff"])
def test_bad_floats(data: bytes) -> None:
    """A text that is not as many finite numbers as there are fields is refused in words."""
    with pytest.raises(TypesError):
        FloatsForm(twists, TWIST).messages(data)


@given(st.binary(max_size=60))
def test_any_bytes(data: bytes) -> None:
    """Whatever a robot sends is converted or refused; nothing else comes of it."""
    forms: list[Form] = [
        FloatsForm(twists, TWIST),
        CodesForm(twists, CODES),
        AngleForm(twists),
        JsonForm(twists),
        JsonForm(twists, {"linear.x": "a.b.0"}),
        TextForm(registry.codec("std_msgs/msg/Int32")),
        TextForm(registry.codec("std_msgs/msg/Bool")),
        TextForm(registry.codec("std_msgs/msg/Float64")),
    ]
    for form in forms:
        try:
            form.messages(data)
        except FAILURES:
            continue


@pytest.mark.parametrize(
    ("type", "text"),
    [("String", "größe, 50 %"), ("Int32", "-7"), ("UInt8", "200"), ("Float64", "0.5"), ("Bool", "true")],
)
def test_text(type: str, text: str) -> None:
    """Types with one field are written as that field."""
    form = TextForm(registry.codec(f"std_msgs/msg/{type}"))
    ((_, cdr),) = form.messages(text.encode())
    assert form.text(cdr) == text.encode()


def test_text_is_for_one_field() -> None:
    """Types with more fields, or none that is a text or a number, cannot be texts."""
    for type in ("geometry_msgs/msg/Point", "std_msgs/msg/Header", "geometry_msgs/msg/Vector3Stamped"):
        with pytest.raises(TypesError, match=r"the form text is for types with one|use the form json"):
            TextForm(registry.codec(type))
    for type, text in (("Int32", b"1.5"), ("Bool", b"maybe"), ("UInt8", b"300"), ("Float64", b"inf")):
        with pytest.raises(TypesError):
            TextForm(registry.codec(f"std_msgs/msg/{type}")).messages(text)


def test_json() -> None:
    """Without fields the whole message stands in the JSON text, as rosbridge has it."""
    form = JsonForm(twists)
    ((_, cdr),) = form.messages(b'{"linear": {"x": 1.5}}')
    assert cdr == twist(1.5)
    assert json.loads(form.text(cdr))["linear"]["x"] == 1.5


def test_json_fields() -> None:
    """Fields of the message stand where the map says, also in a list; what is not there gets its default."""
    form = JsonForm(twists, {"linear.x": "speed", "angular.z": "turn.rates.1"})
    ((_, cdr),) = form.messages(b'{"speed": 2, "turn": {"rates": [9, 0.25]}, "other": null}')
    assert cdr == twist(2.0, 0.25)
    ((_, cdr),) = form.messages(b"{}")
    assert cdr == twist()
    simple = JsonForm(twists, {"linear.x": "a.b", "angular.z": "a.c"})
    assert json.loads(simple.text(twist(1.0, 2.0))) == {"a": {"b": 1.0, "c": 2.0}}


def test_unknown_fields() -> None:
    """A path that the type has not is told when the form is made."""
    for make in (
        lambda: FloatsForm(twists, ["linear.w"]),
        lambda: JsonForm(twists, {"linear.x.y": "a"}),
        lambda: CodesForm(twists, {"0": {"speed": 1.0}}),
        lambda: AngleForm(twists, "angular.w"),
    ):
        with pytest.raises(TypesError, match="has no field"):
            make()


@pytest.mark.parametrize(
    ("x", "z", "code"),
    [(0.5, 0.0, b"0"), (-0.01, 0.0, b"1"), (0.0, 1.0, b"2"), (0.1, -1.0, b"3"), (0.0, 0.0, b"4"), (5.0, 0.5, b"0")],
)
def test_codes_out(x: float, z: float, code: bytes) -> None:
    """A message becomes the code that points the same way."""
    assert CodesForm(twists, CODES).text(twist(x, z)) == code


def test_codes_in() -> None:
    """A code becomes the fields it stands for; one that nobody knows is refused with those that are."""
    form = CodesForm(twists, CODES)
    assert form.messages(b" 3 ") == [(0.0, twist(0.0, -0.5))]
    with pytest.raises(TypesError, match="expected one of 0, 1, 2, 3, 4, got 'fly'"):
        form.messages(b"fly")


def test_codes_sent() -> None:
    """Codes that are not sent are understood all the same; a message that they alone would fit says nothing."""
    form = CodesForm(twists, CODES, send=["0", "1"])
    assert form.messages(b"2") == [(0.0, twist(0.0, 0.5))]
    assert form.text(twist(0.0, 0.5)) is None
    assert form.text(twist()) is None
    assert form.text(twist(-1.0)) == b"1"


def test_angle_in() -> None:
    """An angle becomes a rate, and a stop when it is done; zero is a stop."""
    form = AngleForm(twists, rate_rad_s=0.5)
    (begin, end) = form.messages(b"-90")
    assert begin == (0.0, twist(0.0, -0.5))
    assert end[0] == pytest.approx(math.pi)
    assert end[1] == twist()
    assert form.messages(b"0") == [(0.0, twist())]


@given(
    st.lists(st.tuples(st.floats(0.01, 0.9), st.floats(-2.0, 2.0)), min_size=1, max_size=40),
    st.floats(0.5, 30.0),
)
def test_angles_add_up(steps: list[tuple[float, float]], step_deg: float) -> None:
    """However rates come, the angles that are sent add up to what a robot would have turned."""
    now = 0.0
    form = AngleForm(twists, step_deg=step_deg, hold_s=1.0, clock=lambda: now)
    sent, turned = 0.0, 0.0
    for seconds, rate in steps:
        text = form.text(twist(0.0, rate))
        sent += float(text) if text is not None else 0.0
        turned += math.degrees(rate * seconds)
        now += seconds
    text = form.text(twist())
    sent += float(text) if text is not None else 0.0
    assert sent == pytest.approx(turned, abs=0.5 + 0.06 * (len(steps) + 1))


def test_angle_holds_for_a_time() -> None:
    """A rate that is not repeated holds for a time only, as a robot's driver has it."""
    now = 0.0
    form = AngleForm(twists, hold_s=1.0, clock=lambda: now)
    assert form.text(twist(0.0, math.radians(45))) is None
    now = 100.0
    assert form.text(twist()) == b"45.0"


def test_made_by_name() -> None:
    """A form is made by its name and options; without a map a String is text and others are JSON."""
    made = make_form("codes", "geometry_msgs/msg/Twist", registry, {"codes": CODES, "send": ["4"]}, clock=lambda: 0.0)
    assert made.text(twist()) == b"4"
    assert make_form("floats", "geometry_msgs/msg/Twist", registry, {}, clock=lambda: 0.0).text(twist(1.0)) is not None
    assert isinstance(default_form("std_msgs/msg/String", registry), TextForm)
    assert isinstance(default_form("geometry_msgs/msg/Twist", registry), JsonForm)


@given(st.binary(max_size=2000), st.sampled_from(RAW_TYPES))
def test_raw(data: bytes, type: str) -> None:
    """Any bytes become a message of bytes, and the same bytes again."""
    form = make_form("raw", type, registry, {}, clock=lambda: 0.0)
    ((delay_s, cdr),) = form.messages(data)
    assert (delay_s, registry.codec(type).decode(cdr)["data"], form.text(cdr)) == (0.0, data, data)


def test_raw_types() -> None:
    """The form raw is refused for a type that is no array of bytes."""
    with pytest.raises(TypesError, match="the form raw is for"):
        RawForm(twists)


def test_cdr() -> None:
    """The form cdr takes and gives a message as it is, and refuses what is none of its type."""
    form = CdrForm(twists)
    assert form.messages(twist(1.0)) == [(0.0, twist(1.0))]
    assert form.text(twist(1.0)) == twist(1.0)
    for bad in (b"", b"\0\1\0", twist()[:-1], b"\0\1\0\0"):
        with pytest.raises(TypesError):
            form.messages(bad)
