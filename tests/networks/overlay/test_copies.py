"""Which packets have a copy that goes by the bypass."""

from __future__ import annotations

from ropeway.limits import OVERLAY_COPY_BYTES
from ropeway.networks.overlay.copies import Copies, CopyBudget

NEAR, FAR = b"n" * 16, b"f" * 16


def test_what_is_on_its_way_goes_first() -> None:
    """The first copy, and the first by another connection, follows what was sent just before and has none."""
    sent: list[tuple[bytes, bytes]] = []
    copies = Copies(lambda gateway, packet: sent.append((gateway, packet)))
    copies.send(b"old", [], 1, 0.0)
    copies.send(b"1", [FAR], 0, 5.0)
    assert not sent
    copies.send(b"2", [FAR], 1, 5.02)
    copies.send(b"3", [FAR, NEAR], 1, 5.04)
    assert sent == [(FAR, b"1"), (FAR, b"2"), (FAR, b"3"), (NEAR, b"1"), (NEAR, b"2"), (NEAR, b"3")]
    sent.clear()
    copies.send(b"4", [FAR], 2, 6.0)
    copies.send(b"5", [], 2, 6.02)
    copies.send(b"6", [FAR], 2, 6.04)
    assert sent == [(FAR, b"4"), (FAR, b"4"), (FAR, b"5"), (FAR, b"6")]


def test_who_sends_much_is_left_out() -> None:
    """Copies take a small part of the path: the publisher with most bytes goes without, the others go on."""
    budget = CopyBudget()
    command, flood = b"c" * 16, b"f" * 16
    taken = [budget.takes(flood, 2_000, 100_000, 0.001 * i) for i in range(100)]
    assert taken.index(False) * 2_000 <= 100_000 / 8
    assert not any(taken[taken.index(False) :])
    assert all(budget.takes(command, 100, 100_000, 0.1 + 0.02 * i) for i in range(1000))
    assert not budget.takes(flood, 2_000, 100_000, 20.1)
    assert budget.takes(flood, 2_000, 100_000, 60.0)


def test_what_is_large_has_none() -> None:
    """A packet above the limit has no copy."""
    assert not CopyBudget().takes(FAR, OVERLAY_COPY_BYTES + 1, 1e9, 0.0)
