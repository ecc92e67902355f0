"""What the ends of a route show."""

from __future__ import annotations

from collections.abc import AsyncIterator

import pytest

from ropeway.gateway.explain.ends import publishers, readers, servers
from ropeway.gateway.explain.explanation import Finding, Subject
from ropeway.networks.memory.graph import MemoryGraph
from ropeway.qos import DEFAULT, QoS

STRING, ODOMETRY = "std_msgs/msg/String", "nav_msgs/msg/Odometry"
ADD = "example_interfaces/srv/AddTwoInts"


@pytest.fixture
async def graphs(request: pytest.FixtureRequest) -> AsyncIterator[tuple[MemoryGraph, MemoryGraph]]:
    """Our graph, and that of a robot's driver on the same network."""
    name = request.node.name.replace("[", "-").replace("]", "")
    ours, driver = MemoryGraph(name, node="/gateway"), MemoryGraph(name, node="/driver")
    await ours.open()
    await driver.open()
    yield ours, driver
    await driver.close()
    await ours.close()


def verdicts(findings: list[Finding]) -> dict[Subject, bool | None]:
    """Return the verdict on each subject."""
    return {finding.subject: finding.ok for finding in findings}


async def test_a_healthy_publisher(graphs: tuple[MemoryGraph, MemoryGraph]) -> None:
    """A publisher of the right type is named with its node, and its QoS is adopted."""
    ours, driver = graphs
    await driver.create_publisher("/odom", ODOMETRY)
    found = publishers(ours, "/odom", ODOMETRY, None)
    assert verdicts(found) == {Subject.SOURCE: True, Subject.TYPE: True, Subject.QOS: True}
    assert found[0].text == "1 publisher of /odom (/driver)"


async def test_a_misspelt_topic(graphs: tuple[MemoryGraph, MemoryGraph]) -> None:
    """Where nobody publishes a topic, the nearest that somebody does is told."""
    ours, driver = graphs
    await driver.create_publisher("/odom", ODOMETRY)
    (found,) = publishers(ours, "/odomm", ODOMETRY, None)
    assert (found.subject, found.ok, found.near) == (Subject.SOURCE, False, "/odom")
    assert found.text == f"nobody publishes /odomm on {ours.name}; did you mean /odom?"


async def test_our_own_publisher_is_no_source(graphs: tuple[MemoryGraph, MemoryGraph]) -> None:
    """What we publish ourselves is not somebody who publishes."""
    ours, _ = graphs
    await ours.create_publisher("/odom", ODOMETRY)
    assert publishers(ours, "/odom", ODOMETRY, None)[0].ok is False


async def test_another_type(graphs: tuple[MemoryGraph, MemoryGraph]) -> None:
    """A topic of another type names both."""
    ours, driver = graphs
    await driver.create_publisher("/odom", ODOMETRY)
    found = publishers(ours, "/odom", STRING, None)
    assert verdicts(found) == {Subject.SOURCE: True, Subject.TYPE: False}
    assert ODOMETRY in found[1].text
    assert f"the route says {STRING}" in found[1].text


async def test_incompatible_qos(graphs: tuple[MemoryGraph, MemoryGraph]) -> None:
    """A reader that asks for more than every publisher offers gets nothing, and the policy is named as ROS 2 does."""
    ours, driver = graphs
    await driver.create_publisher("/scan", STRING, QoS(reliability="best_effort"))
    found = publishers(ours, "/scan", STRING, DEFAULT)
    assert verdicts(found)[Subject.QOS] is False
    assert "incompatible QoS (RELIABILITY)" in found[-1].text
    await driver.create_publisher("/scan", STRING)
    found = publishers(ours, "/scan", STRING, DEFAULT)
    assert verdicts(found)[Subject.QOS] is True
    assert found[-1].text.startswith("a publisher offers incompatible QoS")


async def test_an_empty_network(request: pytest.FixtureRequest) -> None:
    """Where nobody else is on the network, that is what is told."""
    ours = MemoryGraph(request.node.name, node="/gateway")
    await ours.open()
    (found,) = publishers(ours, "/odom", ODOMETRY, None)
    assert (found.subject, found.ok) == (Subject.NETWORK, False)
    assert found.text == f"nobody else is on {ours.name}, so nobody publishes /odom"
    await ours.close()


async def test_readers(graphs: tuple[MemoryGraph, MemoryGraph]) -> None:
    """Readers are named; without any, nothing is sent; one that asks for more than is offered gets nothing."""
    ours, driver = graphs
    assert verdicts(readers(ours, "/map", STRING, DEFAULT)) == {Subject.READERS: False}
    await driver.create_subscription("/map", STRING, QoS(durability="transient_local"), lambda _: None)
    found = readers(ours, "/map", STRING, DEFAULT)
    assert verdicts(found) == {Subject.READERS: True, Subject.TYPE: True, Subject.QOS: False}
    assert "1 reader of /map (/driver)" in found[0].text
    assert "(DURABILITY)" in found[-1].text


async def test_servers(graphs: tuple[MemoryGraph, MemoryGraph]) -> None:
    """A service is looked for by name and type, and the nearest name is told."""
    ours, driver = graphs

    async def add(_: object) -> bytes:
        return b""

    await driver.create_service("/add", ADD, add)
    assert verdicts(servers(ours, "service", "/add", ADD)) == {Subject.SOURCE: True, Subject.TYPE: True}
    assert verdicts(servers(ours, "service", "/add", "std_srvs/srv/Trigger"))[Subject.TYPE] is False
    assert servers(ours, "service", "/ad", ADD)[0].near == "/add"
    assert servers(ours, "action", "/add", ADD)[0].ok is False
