"""A plan knows which topics share which link."""

from __future__ import annotations

from ropeway.planning import PlannedLink, PlannedTopic, TrafficPlan


def topic(name: str, publishers: dict[str, int], readers: dict[str, int]) -> PlannedTopic:
    """Make a topic of 1 kB at 10 Hz."""
    return PlannedTopic(name, 1000, 10, publishers, readers)


def test_copies() -> None:
    """Plain DDS sends a copy per publisher and reader, gateways one per publisher and host."""
    asked = topic("/a", {"robot": 2}, {"cloud": 3})
    assert asked.copies(("robot", "cloud"), gateways=False) == 6
    assert asked.copies(("robot", "cloud"), gateways=True) == 2
    assert asked.copies(("cloud", "robot"), gateways=False) == 0


def test_what_stays_on_its_host_crosses_no_link() -> None:
    """A topic that is read where it is published goes no way."""
    assert TrafficPlan((topic("/a", {"robot": 1}, {"robot": 2}),), ()).ways() == []


def test_both_ways_of_a_link() -> None:
    """A duplex link is shared per way; one that is not, and one that joins all hosts, by all ways together."""
    topics = (topic("/a", {"robot": 1}, {"cloud": 1}), topic("/b", {"cloud": 1}, {"robot": 1}))
    ways = [("robot", "cloud"), ("cloud", "robot")]
    hosts = frozenset(("robot", "cloud"))
    assert [found for _, found in TrafficPlan(topics, (PlannedLink(1e6, hosts=hosts),)).shares()] == [[w] for w in ways]
    half = PlannedLink(1e6, hosts=hosts, duplex=False)
    assert [found for _, found in TrafficPlan(topics, (half,)).shares()] == [ways]
    assert [found for _, found in TrafficPlan(topics, (PlannedLink(1e6),)).shares()] == [ways]


def test_a_way_counts_on_one_link() -> None:
    """A way goes over the first link that joins its hosts."""
    topics = (topic("/a", {"robot": 1}, {"cloud": 1, "laptop": 1}),)
    fast = PlannedLink(1e9, hosts=frozenset(("robot", "laptop")))
    shares = list(TrafficPlan(topics, (fast, PlannedLink(1e6))).shares())
    assert shares == [(fast, [("robot", "laptop")]), (PlannedLink(1e6), [("robot", "cloud")])]
