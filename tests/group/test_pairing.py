"""ropeway.group.pairing: which request a response answers."""

from __future__ import annotations

from hypothesis import given
from hypothesis import strategies as st

from ropeway.group.pairing import How, Pairing


def test_by_stamp() -> None:
    """Answers that carry the stamp of their request are paired in any order, each once."""
    pairing = Pairing()
    for i in range(3):
        pairing.asked(f"r{i}", i)
    assert [pairing.answered(i) for i in (2, 0, 2, 1)] == ["r2", "r0", None, "r1"]
    assert pairing.counts == {How.STAMP: 3}


def test_the_only_one() -> None:
    """Without stamps, one request under way is the one that is answered."""
    pairing = Pairing()
    pairing.asked("a", None)
    assert pairing.answered(None) == "a"
    assert pairing.counts == {How.ONLY: 1}


def test_by_order() -> None:
    """Without stamps, several requests are taken to be answered in order, and it is said that this is a guess."""
    pairing = Pairing()
    pairing.asked("a", 1)
    pairing.asked("b", 2)
    assert [pairing.answered(None), pairing.answered(None), pairing.answered(None)] == ["a", "b", None]
    assert pairing.counts == {How.ORDER: 1, How.ONLY: 1}


def test_a_stamp_of_its_own() -> None:
    """A machine that stamps its answers with its own time is paired by order as long as no stamp was ever equal."""
    pairing = Pairing()
    pairing.asked("a", 1)
    assert pairing.answered(77) == "a"


def test_no_request() -> None:
    """A message before any request answers none."""
    assert Pairing().answered(5) is None


@given(st.lists(st.tuples(st.booleans(), st.integers(0, 5)), max_size=3000))
def test_bounded_and_once(events: list[tuple[bool, int]]) -> None:
    """Whatever comes, no request is answered twice, and a bounded number waits."""
    pairing, given_out = Pairing(), []
    for number, (asks, stamp) in enumerate(events):
        if asks:
            pairing.asked(number, stamp)
        elif (key := pairing.answered(stamp)) is not None:
            given_out.append(key)
    assert len(given_out) == len(set(given_out))
    assert len(pairing) <= 1024
