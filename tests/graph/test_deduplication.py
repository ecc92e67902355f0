"""ropeway.graph.deduplication."""

from __future__ import annotations

from ropeway.graph.base import Sample
from ropeway.graph.deduplication import Seen


def sample(origin: bytes, seq: int, relayed: bool = False) -> Sample:
    return Sample(b"", "t", 0, origin, seq, relayed)


def test_knows_what_it_had() -> None:
    """A sample of the same origin and number is known, one of another origin or number is not."""
    seen = Seen()
    seen.add(sample(b"a", 1))
    assert seen.has(sample(b"a", 1))
    assert not seen.has(sample(b"a", 2))
    assert not seen.has(sample(b"b", 1))


def test_relayed_samples_are_known_by_number() -> None:
    """Where one of the two lost its origin on the way, the number alone tells."""
    seen = Seen()
    seen.add(sample(b"a", 1))
    seen.add(sample(b"gateway", 2, relayed=True))
    assert seen.has(sample(b"gateway", 1, relayed=True))
    assert seen.has(sample(b"b", 2))


def test_is_bounded() -> None:
    """Only the last few thousand samples are remembered, and at least the last four thousand."""
    seen = Seen()
    for i in range(100_000):
        seen.add(sample(b"a", i))
    assert seen.has(sample(b"a", 100_000 - 4000))
    assert not seen.has(sample(b"a", 50_000))
    assert len(seen) <= 2 * 4096


def test_takes_in_another() -> None:
    """All that another has seen is known, too, within the same bound."""
    seen, other = Seen(), Seen()
    seen.add(sample(b"a", 1))
    for i in range(2, 6000):
        other.add(sample(b"b", i))
    seen.take_in(other)
    assert seen.has(sample(b"b", 5999))
    assert seen.has(sample(b"b", 2000))
    assert len(seen) <= 2 * 4096
