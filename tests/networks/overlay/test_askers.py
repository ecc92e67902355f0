"""Who asked what is answered."""

from __future__ import annotations

from ropeway.networks.overlay.askers import Askers

ONE, TWO = b"1" * 16, b"2" * 16


def test_by_stamp() -> None:
    """An answer with the stamp of a request belongs to who made it, in whatever order answers come, and once."""
    asked = Askers()
    asked.asked(ONE, b"a")
    asked.asked(TWO, b"b")
    assert asked.answered(b"b") == TWO
    assert asked.answered(b"b") is None
    assert asked.answered(b"a") == ONE


def test_equal_stamps() -> None:
    """Of two requests with the same stamp the first is answered first."""
    asked = Askers()
    asked.asked(ONE, b"a")
    asked.asked(TWO, b"a")
    assert [asked.answered(b"a"), asked.answered(b"a"), asked.answered(b"a")] == [ONE, TWO, None]


def test_in_order() -> None:
    """Without stamps requests are answered in order, and what comes beyond was asked by nobody."""
    asked = Askers()
    asked.asked(ONE, None)
    asked.asked(TWO, None)
    assert [asked.answered(None), asked.answered(None), asked.answered(None)] == [ONE, TWO, None]


def test_forgotten() -> None:
    """What a gateway asked that has left is answered to nobody, and only so many requests are remembered."""
    asked = Askers()
    for number in range(2000):
        asked.asked(ONE if number % 2 else TWO, number.to_bytes(8, "big"))
    assert asked.answered((0).to_bytes(8, "big")) == TWO  # the first of those that are left, in order
    assert asked.answered((1999).to_bytes(8, "big")) == ONE
    assert asked.answered((1).to_bytes(8, "big")) is None
    asked.forget(ONE)
    assert asked.answered((1997).to_bytes(8, "big")) is None
    assert asked.answered((1998).to_bytes(8, "big")) == TWO
