"""ropeway.delivery.pipeline."""

from __future__ import annotations

import pytest

from ropeway.delivery.pipeline import Drop, RateLimit, build, lifespan
from ropeway.graph.base import Delivery, Sample


def sample(stamp_ns: int = 0) -> Sample:
    return Sample(b"", "t", stamp_ns, b"", 1)


@pytest.mark.parametrize(("source_hz", "limit_hz"), [(60, 25), (60, 30), (30, 15), (100, 99), (50, 1), (250, 60)])
def test_reaches_the_rate(source_hz: int, limit_hz: int) -> None:
    """A faster source is limited to the rate that was asked for, not to a fraction of its own."""
    now = 0.0
    limit = RateLimit(limit_hz, lambda: now)
    passed = 0
    for i in range(source_hz * 20):
        now = i / source_hz
        passed += isinstance(limit(sample()), Sample)
    assert passed == pytest.approx(20 * limit_hz, rel=0.02, abs=1)


def test_a_slower_source_passes_whole() -> None:
    """A source below the limit loses nothing, also with jitter."""
    now = 0.0
    limit = RateLimit(30, lambda: now)
    for i in range(300):
        now = i / 29 + (0.004 if i % 2 else 0)
        assert isinstance(limit(sample()), Sample)


def test_no_burst_after_a_pause() -> None:
    """A pause earns at most one extra message."""
    now = 0.0
    limit = RateLimit(10, lambda: now)
    limit(sample())
    now = 100.0
    assert [isinstance(limit(sample()), Sample) for _ in range(5)].count(True) <= 2


def test_lifespan() -> None:
    """A message older than the lifespan is dropped, by the time the first gateway received it."""
    step = lifespan(1.0, lambda: 5_000_000_000)
    fresh = sample(4_500_000_000)
    assert step(fresh) is fresh
    assert step(sample(3_500_000_000)) is Drop.EXPIRED
    travelled = Sample(b"", "t", 5_000_000_000, b"", 1, sent_ns=3_000_000_000)
    assert step(travelled) is Drop.EXPIRED


def test_build() -> None:
    """Only what the route asks for becomes a step."""
    assert build(Delivery()) == []
    assert len(build(Delivery(rate_hz=1, lifespan_s=1))) == 2
