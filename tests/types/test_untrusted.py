"""ropeway.types.untrusted: how deep a value may be nested."""

from __future__ import annotations

import json
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from ropeway.errors import InvalidFrame
from ropeway.types.untrusted import json_loads

_TEXTS = st.text("[]{}a", max_size=8)
_LEVELS = st.lists(st.sampled_from(("list", "dict")), min_size=1, max_size=12)


def _nested(levels: list[str], text: str) -> Any:
    """Return containers within each other, with ``text`` beside each of them."""
    value: Any = text
    for level in levels:
        value = [value, text] if level == "list" else {text: value, f"{text}.": text}
    return value


@given(_LEVELS, _TEXTS, st.integers(1, 12))
def test_nesting_is_bounded_whatever_stands_in_texts(levels: list[str], text: str, limit: int) -> None:
    """A value is refused where its containers are nested beyond the limit; brackets in texts do not count."""
    value = _nested(levels, text)
    data = json.dumps(value).encode()
    if len(levels) <= limit:
        assert json_loads(data, limit) == value
    else:
        with pytest.raises(InvalidFrame, match="nested"):
            json_loads(data, limit)


@given(st.lists(_LEVELS, min_size=1, max_size=40), _TEXTS)
def test_many_containers_beside_each_other_are_not_deep(many: list[list[str]], text: str) -> None:
    """However many containers there are, the deepest of them decides."""
    value = [_nested(levels, text) for levels in many]
    assert json_loads(json.dumps(value).encode(), 13) == value
