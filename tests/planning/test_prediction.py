"""Predictions: rates and delays of topics by encoding."""

from __future__ import annotations

import pytest

from ropeway.planning import PlannedLink, PlannedTopic, TrafficPlan, predict

HOSTS = frozenset(("robot", "cloud"))
SIZES = {"/color": 305_280, "/depth": 203_520}


def plan(hz: float, readers: int, mbit: float = 100, delay_s: float = 0.0, **ratios: float) -> TrafficPlan:
    """Make the plan of two images from the robot to the cloud."""
    topics = (
        PlannedTopic(name, size, hz, {"robot": 1}, {"cloud": readers}, ratios=ratios) for name, size in SIZES.items()
    )
    return TrafficPlan(tuple(topics), (PlannedLink(1e6 * mbit, delay_s, HOSTS),))


def test_the_papers_figures() -> None:
    """The paper's case gives its figures: 8.19 Hz for DDS, 51.6 Hz with LZ4, 18.4 Hz with JSON."""
    rows = predict(plan(60, 3, zip=2.101, none=0.75))
    rates = {row.encoding: row.rate_hz for row in rows if row.topic == "/color"}
    assert rates == pytest.approx({"dds": 8.19, "gateway": 51.6, "zip": 51.6, "none": 18.42}, abs=0.05)


def test_delay() -> None:
    """A message takes the link's delay and its own time on the wire, and at most that of one of every other topic."""
    color, depth = predict(plan(1, 1, mbit=8, delay_s=0.035), ["gateway"])
    assert color.fits
    assert color.delay_s == pytest.approx(0.035 + 0.30528)
    assert color.most_delay_s == depth.most_delay_s == pytest.approx(0.035 + 0.5088)


def test_a_queue_grows_without_a_gateway() -> None:
    """Plain DDS on a link that is too narrow has no delay to name, because its queue grows."""
    row = predict(plan(60, 3), ["dds"])[0]
    assert not row.fits
    assert row.delay_s is None
    assert row.to_json()["way"] == {"from": "robot", "to": "cloud"}


def test_unknown_ratios() -> None:
    """An encoding that was measured for some topics only is not compared; a topic without ratios counts as it is."""
    known = plan(10, 1, zip=2.0).topics[0]
    other = PlannedTopic("/scan", 1000, 10, {"robot": 1}, {"cloud": 1})
    rows = predict(TrafficPlan((known, other), (PlannedLink(1e9, hosts=HOSTS),)))
    assert {row.encoding for row in rows} == {"dds", "gateway"}
    assert [row.bandwidth_bps for row in rows if row.encoding == "gateway"] == [305_280 * 10 * 8 / 2, 80_000]
