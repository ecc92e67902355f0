"""Copies and replays, of packets and of notes."""

from __future__ import annotations

from ropeway.networks.overlay.arrivals import BYPASS, Arrivals, NoteCopies
from ropeway.networks.overlay.crypto.replay_window import WINDOW

FIRST, SECOND = (0, 0), (1, 0)


def test_once_by_each_way() -> None:
    """What came by one way is a copy by another one, once; by the same way it is a replay."""
    arrivals = Arrivals(1)
    arrivals.came(FIRST, 1, 3)
    assert arrivals.is_copy(SECOND, 1, 3)
    assert not arrivals.is_copy(SECOND, 1, 3)
    assert not arrivals.is_copy(SECOND, 3, 1)
    assert not arrivals.is_copy(FIRST, 2, 1)
    assert arrivals.is_copy(BYPASS, 2, 1)


def test_a_way_that_is_far_behind() -> None:
    """A way that is further behind than the replay window reaches still brings copies, each of them once."""
    arrivals = Arrivals(1)
    for number in range(1, 2 * WINDOW):
        arrivals.came(FIRST, number, 1)
    assert [arrivals.is_copy(SECOND, number, 1) for number in (1, 2, 3, 3)] == [True, True, True, False]


def test_what_is_too_old() -> None:
    """What was sent before the reader came is no copy, whichever way it comes."""
    arrivals = Arrivals(100)
    arrivals.came(FIRST, 100, 1)
    assert not arrivals.is_copy(SECOND, 99, 1)
    assert arrivals.is_copy(SECOND, 100, 1)


def test_notes() -> None:
    """A note that came by another session is a copy; one that comes again by the same session is told again."""
    notes = NoteCopies()
    told = [(0, b"a"), (1, b"a"), (1, b"a"), (0, b"a"), (1, b"b"), (0, b"b")]
    assert [notes.is_copy(session, "key", note) for session, note in told] == [False, True, False, False, False, True]
    assert not notes.is_copy(0, "other key", b"b")
    assert notes.count == 2


def test_notes_are_forgotten() -> None:
    """Only the notes of the last moments are remembered."""
    notes = NoteCopies()
    notes.is_copy(0, "key", b"old")
    for number in range(2000):
        notes.is_copy(0, "key", b"%d" % number)
    assert not notes.is_copy(1, "key", b"old")
    assert notes.is_copy(1, "key", b"1999")
