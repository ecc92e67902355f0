"""The delays of clients' messages."""

from __future__ import annotations

from ropeway.delivery.client_delays import ClientDelays


def test_one_histogram_for_all_clients_of_a_topic() -> None:
    """What is published and what is read of a topic is counted apart, whoever does it."""
    delays = ClientDelays()
    for duration_ns in (1_000_000, 3_000_000):
        delays.published("/odom").add(duration_ns)
    delays.read("/odom").add(2_000_000_000)
    told = delays.to_json()
    assert sum(told["published"]["/odom"]["counts"]) == 2
    assert told["published"]["/odom"]["sum_s"] == 0.004
    assert sum(told["read"]["/odom"]["counts"]) == 1


def test_topics_are_bounded() -> None:
    """Topics beyond the limit share a histogram, and those without a message are not told of."""
    delays = ClientDelays(most=2)
    for name in "abcd":
        delays.read(name).add(1)
    delays.published("quiet")
    assert {name: sum(told["counts"]) for name, told in delays.to_json()["read"].items()} == {"a": 1, "b": 1, "": 2}
    assert delays.to_json()["published"] == {}
