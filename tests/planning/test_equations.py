"""The Gateway paper's equations give the paper's figures."""

from __future__ import annotations

import pytest
from hypothesis import given
from hypothesis import strategies as st

from ropeway.planning.equations import (
    DEFAULT_LZ4_RATIO,
    Load,
    bandwidth_bps,
    gateway_bandwidth_bps,
    received_rate_hz,
    shared_rates_hz,
)

IMAGES = (424 * 240 * 3, 424 * 240 * 2)  # bytes of a colour and a depth image
LINK_BPS = 100e6


def _images(hz: float, readers: int = 1) -> list[Load]:
    return [Load(size, hz, readers) for size in IMAGES]


@pytest.mark.parametrize("hz", [15, 30, 60])
def test_plain_dds_with_three_readers(hz: float) -> None:
    """Equations (3) and (4) predict 8.19 Hz for three readers of both images, however often these are published."""
    needed = bandwidth_bps(_images(hz, readers=3))
    assert received_rate_hz(hz, LINK_BPS, needed) == pytest.approx(8.19, abs=0.005)


@pytest.mark.parametrize(
    ("hz", "ratio", "expected"),
    [
        (15, 1, 15),
        (30, 1, 24.57),
        (60, 1, 24.57),
        (15, DEFAULT_LZ4_RATIO, 15),
        (30, DEFAULT_LZ4_RATIO, 30),
        (60, DEFAULT_LZ4_RATIO, 51.6),
        (60, 3 / 4, 18.4),  # JSON has four characters for three bytes
    ],
)
def test_gateways(hz: float, ratio: float, expected: float) -> None:
    """Equations (5) and (4) predict what one copy per host allows, compressed by one ratio."""
    needed = gateway_bandwidth_bps(_images(hz), ratio)
    assert received_rate_hz(hz, LINK_BPS, needed) == pytest.approx(expected, abs=0.05)


def test_offered_load() -> None:
    """Both images at 60 Hz are 244 Mbit/s."""
    assert bandwidth_bps(_images(60)) == pytest.approx(244.2e6, rel=0.001)


def test_a_small_topic_has_its_rate_beside_big_ones() -> None:
    """A topic that asks for less than its share of the bytes gets all it asks for; the others share the rest."""
    command, *images = shared_rates_hz([Load(100, 50), *_images(60)], LINK_BPS)
    assert command == 50
    assert images[0] * IMAGES[0] == pytest.approx(images[1] * IMAGES[1])
    assert 8 * (command * 100 + images[0] * IMAGES[0] + images[1] * IMAGES[1]) == pytest.approx(LINK_BPS)


loads = st.builds(Load, st.floats(1, 1e7), st.floats(0.1, 1e3), st.integers(1, 5), st.floats(0.5, 50))


@given(st.lists(loads, min_size=1, max_size=20), st.floats(1e3, 1e10))
def test_shares(topics: list[Load], link_bps: float) -> None:
    """Shares by bytes fill the link or give everybody all, and nobody more than is published."""
    rates = shared_rates_hz(topics, link_bps)
    used = sum(load.bandwidth_bps * rate / load.published_hz for load, rate in zip(topics, rates, strict=True))
    assert used == pytest.approx(min(link_bps, bandwidth_bps(topics)), rel=1e-6)
    assert all(0 < rate <= load.published_hz * (1 + 1e-9) for load, rate in zip(topics, rates, strict=True))
