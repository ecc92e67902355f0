"""Messages of one publisher, in order."""

from __future__ import annotations

from hypothesis import given
from hypothesis import strategies as st

from ropeway.networks.overlay.follower import Follower
from ropeway.networks.overlay.packet_item import RAW, PacketItem


def item(number: int) -> PacketItem:
    return PacketItem(number, 0, 0, bytes(16), 0, RAW, b"%d" % number)


def items(*numbers: int) -> list[PacketItem]:
    return [item(number) for number in numbers]


def follower(*, reliable: bool = True, history: bool = False, start: int = 0) -> Follower:
    return Follower(reliable=reliable, history=history, start=start)


def test_gives_in_order() -> None:
    """Messages that come in order are given at once, and what was there before the reader is not missed."""
    reader = follower(start=7)
    assert reader.arrived(items(8, 9)) == items(8, 9)
    assert reader.missing is None
    assert reader.lost == 0


def test_gap_of_reliable() -> None:
    """A gap is asked for, and what comes after it waits until the answer has come."""
    reader = follower(start=1)
    assert reader.arrived(items(2, 5)) == items(2)
    assert reader.missing == (2, 4)
    assert reader.arrived(items(6)) == []
    assert reader.recovered(items(3, 4)) == items(3, 4, 5, 6)
    assert reader.missing is None
    assert (reader.last, reader.lost) == (6, 0)


def test_gap_that_fills_by_itself() -> None:
    """What comes late is given at once, with what waited for it; the answer that was asked for changes nothing."""
    reader = follower()
    assert reader.arrived(items(2, 3, 5)) == []
    assert reader.missing == (0, 1)
    assert reader.arrived(items(1)) == items(1, 2, 3)
    assert reader.arrived(items(4, 6)) == items(4, 5, 6)
    assert reader.recovered(items(1)) == []
    assert reader.missing is None
    assert reader.arrived(items(7)) == items(7)
    assert (reader.last, reader.lost) == (7, 0)


def test_gap_of_best_effort() -> None:
    """A best-effort reader takes what comes, and nothing twice or late."""
    reader = follower(reliable=False)
    assert reader.arrived(items(1, 5)) == items(1, 5)
    assert reader.arrived(items(3, 5, 6)) == items(6)
    assert reader.missing is None


def test_gives_up() -> None:
    """What cannot be had is counted as lost, and the rest is given."""
    reader = follower()
    assert reader.arrived(items(4)) == []
    assert reader.give_up() == items(4)
    assert reader.lost == 3


def test_history_first() -> None:
    """A latched reader gets what was published before it came, then what came meanwhile, each once."""
    reader = follower(history=True, start=5)
    assert reader.missing == (0, None)
    assert reader.arrived(items(6)) == []
    assert reader.recovered(items(4, 5, 6)) == items(4, 5, 6)
    assert reader.arrived(items(6, 7)) == items(7)
    assert reader.lost == 0


def test_told_of_the_end() -> None:
    """A reader that is told of a newer message asks for it, though nothing else comes."""
    reader = follower()
    reader.told(0)
    assert reader.missing is None
    reader.told(2)
    assert reader.missing == (0, 2)
    assert reader.recovered(items(1, 2)) == items(1, 2)
    reader.told(2)
    assert reader.missing is None
    follower(reliable=False).told(9)


def test_end_that_is_not_kept() -> None:
    """What the publisher keeps no longer is lost, and not asked for again."""
    reader = follower()
    reader.told(4)
    assert reader.recovered(items(3)) == items(3)
    assert (reader.last, reader.lost) == (4, 3)


def test_holds_within_bounds() -> None:
    """What waits for an answer is bounded; beyond, the answer is given up."""
    reader = follower()
    given = reader.arrived(item(number) for number in range(2, 5000))
    assert [i.number for i in given] == list(range(2, 5000))
    assert reader.lost == 1


@given(st.lists(st.integers(1, 30), max_size=60), st.booleans(), st.booleans())
def test_never_back_never_twice(numbers: list[int], reliable: bool, recovers: bool) -> None:
    """Whatever comes in whatever order, numbers only grow, and with an answer to each question none is missing."""
    reader = follower(reliable=reliable)
    got: list[int] = []
    for number in numbers:
        got += [i.number for i in reader.arrived([item(number)])]
        if reader.missing is not None:
            after, upto = reader.missing
            assert upto is not None
            answer = items(*range(after + 1, upto + 1)) if recovers else []
            got += [i.number for i in reader.recovered(answer)]
    assert got == sorted(set(got))
    if reliable and recovers and got:
        assert got == list(range(1, got[-1] + 1))
