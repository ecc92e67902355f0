"""A gateway's configuration is a plan, as far as it says what to expect."""

from __future__ import annotations

from typing import Any

from ropeway.gateway.config.config import Config, parse
from ropeway.planning import PlannedLink, PlannedTopic
from ropeway.planning.configured import plan_of, unfitting

IMAGE = {"name": "/color", "type": "sensor_msgs/Image"}
EXPECTED = {"bytes": 305280, "hz": 60, "readers": 3}


def config(operation: str = "publish", link: Any = None, **item: Any) -> Config:
    """Make a configuration with one topic."""
    remote = {"address": "ws://cloud:9090", operation: [{**IMAGE, **item}]}
    return parse({"gateway": {"name": "robot"}, "remotes": [remote | ({"link": link} if link else {})]})


def test_expected_traffic() -> None:
    """A topic with ``expected`` at a remote with ``link`` goes from the gateway to the remote."""
    plan, left_out = plan_of(config(link={"mbit": 20, "delay_ms": 10}, expected=EXPECTED))
    assert left_out == []
    assert plan.ways() == [("robot", "ws://cloud:9090")]
    assert plan.topics[0].readers == {"ws://cloud:9090": 3}
    assert plan.links[0].rate_bps == 20e6
    assert plan.links[0].delay_s == 0.01


def test_subscribed_topics_come_the_other_way() -> None:
    """A subscribed topic comes from the remote."""
    plan, _ = plan_of(config("subscribe", link={"mbit": 20}, expected=EXPECTED))
    assert plan.ways() == [("ws://cloud:9090", "robot")]


def test_limits_count() -> None:
    """A topic that is limited crosses at its limit."""
    plan, _ = plan_of(config(link={"mbit": 20}, expected=EXPECTED, rate_hz=5))
    assert plan.topics[0].published_hz == 5


def test_nothing_is_invented() -> None:
    """A topic of which nothing is known, or whose link is unknown, is left out by its path."""
    assert plan_of(config(link={"mbit": 20}))[1] == ["remotes[0].publish[0]"]
    assert plan_of(config(expected=EXPECTED))[1] == ["remotes[0].publish[0]"]


def test_measured_topics_and_a_given_link() -> None:
    """Measurements and a link from elsewhere fill in what the configuration does not say."""
    measured = PlannedTopic("/color", 1000, 10, {"x": 1}, {"y": 1}, ratios={"zip": 2.0})
    plan, left_out = plan_of(config(), {"/color": measured}, PlannedLink(1e6))
    assert left_out == []
    assert plan.topics[0].publishers == {"robot": 1}
    assert plan.topics[0].ratios == {"zip": 2.0}


def test_a_warning_where_topics_do_not_fit() -> None:
    """A link that is asked for more than it carries is named, with what will arrive."""
    (sentence,) = unfitting(config(link={"mbit": 20}, expected=EXPECTED))
    assert "146.5 Mbit/s" in sentence
    assert "8.2 of 60 Hz" in sentence
    assert unfitting(config(link={"mbit": 20}, expected=EXPECTED, rate_hz=5)) == []
    assert unfitting(config(link={"mbit": 200}, expected=EXPECTED)) == []
