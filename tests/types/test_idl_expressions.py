"""ropeway.types.idl_expressions."""

from __future__ import annotations

import pytest
from hypothesis import given
from hypothesis import strategies as st

from ropeway.types.definition import FieldType
from ropeway.types.idl_expressions import Expressions, Value
from ropeway.types.idl_tokens import IdlError, tokens


def reading(text: str, **known: Value) -> Expressions:
    made = Expressions(list(tokens(text)))
    made.known.update({(name,): value for name, value in known.items()})
    return made


def value(text: str, **known: Value) -> Value:
    return reading(text, **known).expression()


@pytest.mark.parametrize(
    ("text", "result"),
    [
        ("1 + 2 * 3", 7),
        ("(1 + 2) * 3", 9),
        ("10 - 4 - 3", 3),
        ("7 / 2", 3),
        ("7.0 / 2", 3.5),
        ("7 % 4", 3),
        ("1 << 3 | 1", 9),
        ("6 & 3 ^ 1 | 8", 11),
        ("32 >> 2", 8),
        ("-~1", 2),
        ("+1.5f", 1.5),
        ("0x1F", 31),
        ("010", 8),
        ("1e3", 1000.0),
        ("5UL", 5),
        ("'A'", 65),
        ('"a" "b"', "ab"),
        ("TRUE", True),
        ("N * 2", 6),
    ],
)
def test_values(text: str, result: Value) -> None:
    """Expressions have the value that the operators and literals of C++ give them, with its precedence."""
    found = value(text, N=3)
    assert (found, type(found)) == (result, type(result))


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("1 / 0", "the expression has no value"),
        ("1 % 0", "the expression has no value"),
        ("1 << 64", "64 is not a number of bits to shift by"),
        ("1 << -1", "-1 is not a number of bits to shift by"),
        ("1.5 & 1", "& needs numbers"),
        ('1 + "a"', "\\+ needs numbers"),
        ('-"a"', "- needs a number"),
        ("~1.5", "~ needs a number"),
        ("09", "09 is not a number"),
        ("0xFFFFFFFFFFFFFFFF * 4", "a number is beyond 64 bits"),
        ("M", "M is not a known constant"),
        ("(1", "expected '\\)', found 'the end'"),
        ("", "expected a value, found 'the end'"),
        ("(" * 65 + "1", "nested too deeply"),
    ],
)
def test_faults(text: str, said: str) -> None:
    """An expression without a value says why, at its line."""
    with pytest.raises(IdlError, match=said):
        value(text, N=3)


def test_a_type_is_no_constant() -> None:
    """The name of a type has no value."""
    made = reading("T")
    made.known["T",] = FieldType("int32")
    with pytest.raises(IdlError, match="T is not a known constant"):
        made.expression()


def test_the_innermost_module_wins() -> None:
    """A name means what the innermost module around it defines; one that begins with ``::`` is looked up outside."""
    made = Expressions(list(tokens("N + a::N * 10 + ::N * 100")))
    made.known.update({("N",): 1, ("a", "N"): 2, ("a", "b", "N"): 3})
    made.scope = ("a", "b")
    assert made.expression() == 3 + 20 + 100


def test_a_sequence_ends() -> None:
    """Where ``>`` closes a bound, two of them are no shift."""
    made = reading("1 + 2 >> ;")
    assert made.expression(">") == 3
    assert made.take(">")
    assert made.take(">")


def test_annotations() -> None:
    """Annotations that mean something to a message are evaluated, all others passed over with what is in them."""
    made = reading('@verbatim(language="c", text=f(1)) @default(value=2 + 3) @key @a::position(7) long')
    assert made.annotations() == {"default": 5, "position": 7}
    assert made.word("a type") == "long"
    with pytest.raises(IdlError, match="expected '\\)', found the end"):
        reading("@unit((m)").annotations()


@given(st.text("0123456789xXeE.+-*/%()<>&|^~ N\"'", max_size=40))
def test_any_expression(text: str) -> None:
    """Any expression has a value within 64 bits, or says that it has none."""
    try:
        found = value(text, N=3)
    except IdlError:
        return
    assert not isinstance(found, int) or abs(found) <= 1 << 64
