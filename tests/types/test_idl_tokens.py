"""ropeway.types.idl_tokens."""

from __future__ import annotations

import pytest
from hypothesis import given
from hypothesis import strategies as st

from ropeway.types.idl_tokens import IdlError, tokens


def texts(idl: str) -> list[tuple[str, str]]:
    return [(token.kind, token.text) for token in tokens(idl)]


def test_kinds() -> None:
    """Names, numbers, signs, texts and characters are told apart, and an end comes last."""
    assert texts("long a[0x1F] = L\"x\" 'c' 1.5e-3;") == [
        ("name", "long"), ("name", "a"), ("sign", "["), ("number", "0x1F"), ("sign", "]"), ("sign", "="),
        ("string", "x"), ("character", "c"), ("number", "1.5e-3"), ("sign", ";"), ("end", ""),
    ]  # fmt: skip


def test_signs_of_two_letters() -> None:
    """A scope and a left shift are one sign each; a right shift is two, as two sequences may end there."""
    assert [text for _, text in texts("a::b << c >>")] == ["a", "::", "b", "<<", "c", ">", ">", ""]


def test_lines() -> None:
    """A token has the number of its line, also after comments, texts and directives that have several."""
    found = list(tokens('#include "x"\n/* one\ntwo */ a // three\n"b\n" c'))
    assert [(token.text, token.line) for token in found] == [("a", 3), ("b\n", 4), ("c", 5), ("", 5)]


@pytest.mark.parametrize(
    ("written", "read"),
    [
        (r'"\n\t\\\""', '\n\t\\"'),
        (r'"\x41\101B"', "AAB"),
        (r'"\u00e9"', "é"),
        (r'"\ud800"', "\ufffd"),
        (r'"\q"', "q"),
        (r"'\''", "'"),
    ],
)
def test_escapes(written: str, read: str) -> None:
    """Escapes stand for what C says, one that C does not know for itself, half a surrogate for no character."""
    (token, _) = tokens(written)
    assert token.text == read


@pytest.mark.parametrize(
    ("idl", "said"),
    [
        ("a\n$b", "line 2: '$b' is not IDL"),
        ('"open', "line 1: '\"open' is not IDL"),
        ("#if X", "line 1: '#if X': only #include, #pragma and a guard are understood"),
        ("#define N 3", "line 1: '#define N 3': only #include, #pragma and a guard are understood"),
    ],
)
def test_faults(idl: str, said: str) -> None:
    """What is no IDL, or needs a preprocessor, is named with its line."""
    with pytest.raises(IdlError) as caught:
        list(tokens(idl))
    assert str(caught.value) == said


def test_guard() -> None:
    """The guard around a file is passed over."""
    assert texts("#ifndef A_H\n#define A_H\n#pragma once\na\n#endif\n") == [("name", "a"), ("end", "")]


@given(st.text(max_size=60))
def test_any_text(text: str) -> None:
    """Any text is split, or refused with a line that it has."""
    try:
        assert list(tokens(text))[-1].kind == "end"
    except IdlError as error:
        assert 1 <= error.line <= text.count("\n") + 1
