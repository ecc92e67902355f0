"""ropeway.patterns: quantifiers that give nothing back."""

from __future__ import annotations

import pytest

from ropeway.patterns import compile_possessive


@pytest.mark.parametrize(
    ("pattern", "data", "end"),
    [
        (rb'"(?:[^"\\]++|\\.)*+"', rb'"a\"b" "c"', 6),
        (rb"\{(?:[0-9]++,?+)*+\}", b"{1,22,333}{4}", 10),
        (rb"(?:ab?c)*+", b"acabcab", 5),
    ],
)
def test_groups_in_possessive_quantifiers(pattern: bytes, data: bytes, end: int) -> None:
    """A group is repeated as often as it matches, and no further, on every version of Python."""
    found = compile_possessive(pattern).match(data)
    assert found is not None
    assert found.end() == end


def test_nothing_is_given_back() -> None:
    """What was taken is kept, even if the rest does not match then."""
    assert compile_possessive(rb"a*+a").match(b"aaa") is None
