"""What was sent last over a link."""

from __future__ import annotations

from ropeway.group.recent import Recent
from ropeway.limits import LINK_SENT_AGAIN_BYTES


def test_since() -> None:
    """What was sent since a time is given in order, and once."""
    recent: Recent[str] = Recent()
    for number in range(5):
        recent.note(str(number), 100, 0.1 * number)
    assert recent.take(0.15) == ["2", "3", "4"]
    assert recent.take(0.0) == []


def test_bounds() -> None:
    """What is old is forgotten, and so is what is more than the bound; one that is larger itself is not kept."""
    recent: Recent[str] = Recent()
    recent.note("old", 1, 0.0)
    recent.note("new", LINK_SENT_AGAIN_BYTES // 2, 2.0)
    assert recent.take(0.0) == ["new"]
    recent.note("new", LINK_SENT_AGAIN_BYTES // 2, 2.0)
    recent.note("newer", LINK_SENT_AGAIN_BYTES // 2 + 1, 2.0)
    assert recent.take(0.0) == ["newer"]
    recent.note("huge", LINK_SENT_AGAIN_BYTES + 1, 2.0)
    assert recent.take(0.0) == []
