"""Which endpoints belong together."""

from __future__ import annotations

from ropeway.networks.dds.matching import pair_of, paired, since_of
from ropeway.networks.dds.records import MatchedEndpoint

A, B = b"\x01\x10" + bytes(10), b"\x01\x0f" + bytes(10)


def test_by_mark() -> None:
    """Two endpoints with the same mark belong together, whatever their participant."""
    one, two = MatchedEndpoint(A + b"0001", "serviceid=1"), MatchedEndpoint(A + b"0002", "serviceid=2")
    assert paired((one, two), (MatchedEndpoint(B + b"0003", "serviceid=1"),)) == {one.guid: one}


def test_by_participant() -> None:
    """Endpoints without marks belong together where their participant is the same."""
    one, two = MatchedEndpoint(A + b"0001"), MatchedEndpoint(B + b"0001")
    assert paired((one, two), (MatchedEndpoint(A + b"0002"),)) == {one.guid: one}
    assert paired((one,), ()) == {}


def test_a_mark_is_not_a_participant() -> None:
    """An endpoint whose mark nobody shares has no other half, though its participant has others."""
    assert paired((MatchedEndpoint(A + b"0001", "clientid=1"),), (MatchedEndpoint(A + b"0002"),)) == {}


def test_marks() -> None:
    """Clients and services tell what makes them a pair; others tell nothing."""
    assert pair_of({"clientid": "1.2"}) == "clientid=1.2"
    assert pair_of({"serviceid": "1.2", "typehash": "x"}) == "serviceid=1.2"
    assert pair_of({}) == ""


def test_since() -> None:
    """The time that a service tells is read, and anything else is no time."""
    assert since_of({"since": "1700000000000000000"}) == 1_700_000_000_000_000_000
    for text in ("", "-1", "1e9", "x", "9" * 40, "²"):
        assert since_of({"since": text}) == 0
    assert since_of({}) == 0
