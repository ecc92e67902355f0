"""What two pictures of a network differ in."""

from __future__ import annotations

import logging

import pytest

from ropeway.graph.base import EndpointInfo, GraphEvent, NodeInfo, TopicInfo
from ropeway.graph.calls import ProviderInfo, ServiceInfo
from ropeway.networks.ros2.discovery import Ros2Discovery
from ropeway.networks.ros2.snapshot import Ros2Snapshot
from ropeway.qos import DEFAULT, LATCHED, QoS
from tests.support.messages import STRING


def end(
    name: str, gid: int, *, node: str = "/n", qos: QoS = DEFAULT, local: bool = False, gateway: str = ""
) -> TopicInfo:
    """A topic with one publisher."""
    one = EndpointInfo("publisher", name, STRING, qos, bytes([gid]) * 16, node, gateway=gateway, local=local)
    return TopicInfo(name, (STRING,), (one,))


def both(one: TopicInfo, other: TopicInfo) -> TopicInfo:
    return TopicInfo(one.name, one.types, one.publishers + other.publishers)


def picture(
    *topics: TopicInfo, services: dict[str, ServiceInfo] | None = None, nodes: tuple[str, ...] = ()
) -> Ros2Snapshot:
    return Ros2Snapshot({t.name: t for t in topics}, services or {}, {n: NodeInfo(n) for n in nodes})


class Table:
    """A discovery and what it told."""

    def __init__(self, gateway_id: str = "") -> None:
        self.events: list[GraphEvent] = []
        self.changed: list[set[str]] = []
        self.discovery = Ros2Discovery("ros2:0", gateway_id, self.events.append, self.changed.append)

    def see(self, picture: Ros2Snapshot) -> list[str]:
        self.events.clear()
        self.discovery.apply(picture)
        return sorted(str(event) for event in self.events)


def test_comes_and_goes() -> None:
    """Publishers and nodes of others are told when they come and when they go."""
    table = Table()
    said = table.see(picture(end("/a", 1), nodes=("/n",)))
    assert any("/n publishes /a" in words for words in said)
    assert len(said) == 2
    assert table.see(picture(end("/a", 1), nodes=("/n",))) == []
    assert any("no longer publishes /a" in words for words in table.see(picture()))


def test_waits_for_the_node() -> None:
    """An endpoint whose node is not known yet is told with the next picture."""
    table = Table()
    assert table.see(picture(end("/a", 1, node=""))) == []
    assert not table.discovery.settled
    assert len(table.see(picture(end("/a", 1, node="/late")))) == 1
    assert table.events[0].node == "/late"
    assert table.discovery.settled


def test_nameless() -> None:
    """An endpoint without a node is told all the same, a picture later."""
    table = Table()
    assert table.see(picture(end("/a", 1, node=""))) == []
    assert len(table.see(picture(end("/a", 1, node="")))) == 1
    assert len(table.see(picture())) == 1


def test_own_is_not_told() -> None:
    """What is ours is no news."""
    assert Table().see(picture(end("/a", 1, local=True))) == []


def test_services_and_actions() -> None:
    """Servers are told, those of an action as the action."""
    us, them = ProviderInfo("/us", local=True), ProviderInfo("/them")
    services = {
        "/add": ServiceInfo("/add", ("p/srv/Add",), (them, us)),
        "/mine": ServiceInfo("/mine", ("p/srv/Add",), (us,)),
        "/do/_action/send_goal": ServiceInfo("/do/_action/send_goal", ("p/action/Do_SendGoal",), (them,)),
        "/do/_action/get_result": ServiceInfo("/do/_action/get_result", ("p/action/Do_GetResult",), (them,)),
    }
    table = Table()
    table.see(picture(services=services))
    assert {(e.kind, e.name, e.type, e.node) for e in table.events} == {
        ("service", "/add", "p/srv/Add", "/them"),
        ("action", "/do", "p/action/Do", "/them"),
    }


def test_changed_profiles() -> None:
    """Topics whose publishers come, go or change their profile are handed on; ours do not count."""
    table = Table()
    ours = end("/mine", 2, local=True)
    for seen in (
        picture(end("/a", 1), ours),
        picture(end("/a", 1), ours),
        picture(end("/a", 1, qos=LATCHED)),
        picture(),
    ):
        table.see(seen)
    assert table.changed == [{"/a"}] * 3


def test_hidden_topics() -> None:
    """Topics that are parts of actions are not listed."""
    table = Table()
    table.see(picture(end("/do/_action/feedback", 1), end("/a", 2)))
    assert list(table.discovery.topics()) == ["/a"]


def test_other_gateway(caplog: pytest.LogCaptureFixture) -> None:
    """Another gateway on the network is warned of once, since its messages cannot be told from a node's."""
    table = Table("us")
    there = Ros2Snapshot({}, {}, {}, frozenset({"them"}))
    with caplog.at_level(logging.WARNING):
        table.see(there)
        table.see(there)
    assert [record.getMessage() for record in caplog.records if "them" in record.getMessage()] == [caplog.messages[0]]
