"""ropeway.networks.zenoh.discovery: what tokens tell."""

from __future__ import annotations

from dataclasses import replace

import pytest

from ropeway.graph.base import GraphEvent
from ropeway.networks.zenoh import discovery as module
from ropeway.networks.zenoh.discovery import ZenohDiscovery
from ropeway.networks.zenoh.tokens import NO_HASH, ZenohToken, enclave_of, gid_of
from ropeway.qos import LATCHED

_NODE = ZenohToken(0, "aa", "0", "0", "node", "/talker")
_PUBLISHER = replace(_NODE, kind="publisher", id="1", name="/chatter", type="std_msgs/msg/String", type_hash="RIHS01_1")
_READER = replace(_PUBLISHER, kind="subscription", id="2", node="/listener", session="bb")
_SERVER = replace(_PUBLISHER, kind="server", id="3", name="/add", type="example_interfaces/srv/AddTwoInts")


class Table(ZenohDiscovery):
    """A table that keeps what it tells."""

    def __init__(self, gateway_id: str = "") -> None:
        self.events: list[GraphEvent] = []
        self.changes: list[tuple[set[str], set[str]]] = []
        super().__init__("zenoh", gateway_id, self.events.append, lambda *names: self.changes.append(names))
        self.set_session("cc")

    def show(self, *tokens: ZenohToken) -> None:
        self.apply([(str(token), True) for token in tokens])

    def hide(self, *tokens: ZenohToken) -> None:
        self.apply([(str(token), False) for token in tokens])


def test_topics() -> None:
    """A topic has the endpoints of its tokens, with profile, hash, node and the gid that rmw_zenoh gives them."""
    table = Table()
    table.show(_NODE, replace(_PUBLISHER, qos=LATCHED), _READER)
    topic = table.topics()["/chatter"]
    (publisher,), (reader,) = topic.publishers, topic.subscriptions
    assert (topic.types, publisher.node, reader.node) == (("std_msgs/msg/String",), "/talker", "/listener")
    assert (publisher.qos, publisher.type_hash, publisher.local) == (LATCHED, "RIHS01_1", False)
    assert publisher.gid == gid_of(str(replace(_PUBLISHER, qos=LATCHED)))
    table.hide(_PUBLISHER, replace(_PUBLISHER, qos=LATCHED), _READER)
    assert table.topics() == {}
    assert table.identities == {}


def test_events() -> None:
    """What others show and take back is told once each, what is ours is not."""
    table = Table()
    ours = replace(_PUBLISHER, session="cc")
    table.show(_NODE, _PUBLISHER, _PUBLISHER, _SERVER, ours)
    table.hide(_PUBLISHER, ours, _NODE)
    told = [(event.discovered, event.kind, event.name) for event in table.events]
    assert told == [
        (True, "node", "/talker"),
        (True, "publisher", "/chatter"),
        (True, "service", "/add"),
        (False, "publisher", "/chatter"),
        (False, "node", "/talker"),
    ]
    assert table.changes == [({"/chatter"}, {"/add"}), ({"/chatter"}, set())]


def test_actions() -> None:
    """An action is found by the service that takes its goals, and its parts are no topics and no events."""
    table = Table()
    goal = replace(_SERVER, name="/fib/_action/send_goal", type="example_interfaces/action/Fibonacci_SendGoal")
    feedback = replace(
        _PUBLISHER, name="/fib/_action/feedback", type="example_interfaces/action/Fibonacci_FeedbackMessage"
    )
    table.show(goal, feedback)
    assert table.actions()["/fib"].type == "example_interfaces/action/Fibonacci"
    assert table.look_up("action", "/fib") == table.actions()["/fib"]
    assert table.topics() == {}
    assert table.look_up("topic", "/fib/_action/feedback") is None
    assert [(event.kind, event.name) for event in table.events] == [("action", "/fib")]


def test_nodes() -> None:
    """A node is listed with all that it uses, one whose own token is missing too."""
    table = Table()
    table.show(_NODE, _PUBLISHER, _SERVER, _READER)
    talker, listener = table.nodes()["/talker"], table.nodes()["/listener"]
    assert talker.publishers == (("/chatter", "std_msgs/msg/String"),)
    assert talker.services == (("/add", "example_interfaces/srv/AddTwoInts"),)
    assert listener.subscriptions == (("/chatter", "std_msgs/msg/String"),)
    assert not talker.local


def test_look_up() -> None:
    """One topic or service is looked up by its name; what is not there is none."""
    table = Table()
    table.show(_PUBLISHER, _SERVER)
    assert table.look_up("topic", "/chatter") == table.topics()["/chatter"]
    assert table.look_up("service", "/add") == table.services()["/add"]
    assert table.look_up("service", "/chatter") is None
    assert table.look_up("action", "/add") is None


def test_own_gateway() -> None:
    """Endpoints of other processes of the same gateway are not heard, those of other gateways are relayed."""
    table = Table("robot1")
    same, other = (replace(_PUBLISHER, enclave=enclave_of(id)) for id in ("robot1", "robot2"))
    table.show(same, other, _PUBLISHER)
    assert table.others("publisher", "/chatter", "std_msgs/msg/String") == [other, _PUBLISHER]
    found = [table.identities[gid_of(str(token))] for token in (same, other, _PUBLISHER)]
    assert [(one.ours, one.relayed, one.wanted) for one in found] == [
        (True, False, False),
        (True, True, True),
        (False, False, True),
    ]


def test_hashes() -> None:
    """The hashes of a type are those that others show, and one of them stands for a type that we do not know."""
    table = Table()
    table.show(_PUBLISHER, replace(_PUBLISHER, id="9", type_hash=NO_HASH), replace(_PUBLISHER, session="cc"))
    assert table.hashes("publisher", "/chatter", "std_msgs/msg/String") == {"RIHS01_1", NO_HASH}
    assert table.hash_of("std_msgs/msg/String") == "RIHS01_1"
    assert table.hash_of("std_msgs/msg/Bool") == NO_HASH


def test_copies() -> None:
    """An endpoint of a Ropeway that shows itself under several hashes counts once, and is heard under the first."""
    table = Table()
    first, copy = (replace(_PUBLISHER, enclave=enclave_of("", copy=copy)) for copy in (False, True))
    copy = replace(copy, type_hash="RIHS01_2")
    table.show(first, copy)
    assert table.others("publisher", "/chatter", "std_msgs/msg/String") == [first]
    assert [table.identities[gid_of(str(token))].wanted for token in (first, copy)] == [True, False]
    assert len(table.topics()["/chatter"].publishers) == 2


def test_malformed() -> None:
    """A malformed token is counted, and costs the others of its batch nothing."""
    table = Table()
    table.apply([("@ros2_lv/0/zz", True), (str(_PUBLISHER), True), ("@ros2_lv/0/x/y", False)])
    assert table.malformed == 1
    assert list(table.topics()) == ["/chatter"]


def test_bound(monkeypatch: pytest.MonkeyPatch) -> None:
    """No more tokens are kept than the limit says; the others are counted, and room is used again."""
    monkeypatch.setattr(module, "ZENOH_TOKENS", 3)
    table = Table()
    many = [replace(_PUBLISHER, id=str(number)) for number in range(10)]
    table.show(*many)
    assert (len(table.topics()["/chatter"].publishers), table.unlisted) == (3, 7)
    table.hide(*many)
    table.show(_READER)
    assert len(table.topics()["/chatter"].subscriptions) == 1
