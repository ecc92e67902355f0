"""The limits on what peers may send, and the page that lists them."""

from __future__ import annotations

import re
from collections import Counter
from pathlib import Path

from ropeway import iort, limits
from tests.limits_page import PAGE, written


def test_the_page_lists_every_limit() -> None:
    """The page says each limit with its value and its reason (``python -m tests.limits_page`` writes it)."""
    assert PAGE.read_text() == written()
    names = [name for name in vars(limits) if name.isupper()]
    names += [name.lstrip("_") for name in vars(iort) if name.lstrip("_").startswith(("SERVED", "STRANGERS", "HEAD"))]
    assert names
    for name in names:
        assert f"| `{name}` | " in PAGE.read_text()


def test_limits_are_positive_numbers() -> None:
    """Every limit is a number above zero."""
    assert all(value > 0 for name, value in vars(limits).items() if name.isupper())


def test_every_limit_is_in_force() -> None:
    """What stands among the limits is used by the package, by other limits at least."""
    home = Path(limits.__file__)
    names = re.findall(r"^([A-Z][A-Z0-9_]*): Final = ", home.read_text(), re.MULTILINE)
    assert names
    sources = [path.read_text() for path in home.parent.rglob("*.py")]
    used = Counter(word for text in sources for word in re.findall(r"\b[A-Z][A-Z0-9_]+\b", text))
    assert [name for name in names if used[name] < 2] == []
