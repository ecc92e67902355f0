"""The table of what is discovered, fed by hand."""

from __future__ import annotations

import asyncio

import pytest

from ropeway.graph.base import GraphEvent
from ropeway.graph.calls import ProviderInfo, ServiceInfo
from ropeway.networks.dds import discovery as module
from ropeway.networks.dds.discovery import DdsDiscovery
from ropeway.networks.dds.nodes import NodeEntities
from ropeway.networks.dds.records import EndpointRecord, Gone, Joined, NodesRecord
from ropeway.qos import QoS
from tests.support.messages import STRING
from tests.support.until import until

from .helpers import DDS_STRING

P1, P2 = b"\1" * 16, b"\2" * 16


class Table:
    """A Discovery and what it told."""

    def __init__(self, gateway_id: str = "") -> None:
        self.events: list[GraphEvent] = []
        self.changed: list[set[str]] = []
        self.sizes: list[set[int]] = []
        self.table = DdsDiscovery("dds:0", gateway_id, self.events.append, self.changed.append, self.sizes.append)

    @property
    def told(self) -> list[str]:
        return [str(e).removeprefix("dds:0: ") for e in self.events]


def endpoint(
    handle: int, topic: str = "rt/t", type: str = DDS_STRING, kind: str = "publisher", **other: object
) -> EndpointRecord:
    """A record of an endpoint of P1."""
    values: dict[str, object] = {
        "qos": QoS(),
        "type_hash": "",
        "gateway": "",
        "local": False,
        "guid": P1[:12] + handle.to_bytes(4, "big"),
        "participant": P1,
        **other,
    }
    return EndpointRecord(kind=kind, handle=handle, dds_topic=topic, dds_type=type, **values)  # type: ignore[arg-type]


def nodes(participant: bytes, *entities: NodeEntities, local: bool = False, gid_bytes: int = 16) -> NodesRecord:
    """What a participant tells of its nodes."""
    return NodesRecord(participant, entities, gid_bytes, local)


async def test_names_the_node() -> None:
    """An endpoint that is discovered before its node is told of once the node is known."""
    t = Table()
    record = endpoint(1)
    t.table.apply([Joined(P1), record])
    assert t.told == []
    t.table.apply([nodes(P1, NodeEntities("/talker", (), (record.guid,)))])
    assert t.told == ["node /talker has appeared", f"node /talker publishes /t ({STRING})"]
    t.table.close()


async def test_names_nobody(monkeypatch: pytest.MonkeyPatch) -> None:
    """An endpoint without a node is told of after a moment."""
    monkeypatch.setattr(module, "_NODE_GRACE_S", 0.01)
    t = Table()
    t.table.apply([endpoint(1)])
    await until(lambda: t.told)
    assert t.told == [f"a participant publishes /t ({STRING})"]
    t.table.apply([Gone("publisher", 1, b"")])
    assert t.told[1:] == [f"a participant no longer publishes /t ({STRING})"]


async def test_short_life() -> None:
    """An endpoint that leaves before its node is known is told of twice all the same."""
    t = Table()
    record = endpoint(1)
    t.table.apply([record, Gone("publisher", 1, record.guid)])
    assert len(t.told) == 2
    assert t.table.topics() == {}
    t.table.close()


@pytest.mark.jumping
async def test_closed() -> None:
    """A closed table tells nothing more."""
    t = Table()
    t.table.apply([endpoint(1)])
    t.table.close()
    await asyncio.sleep(0.3)
    assert t.told == []


async def test_late_nodes() -> None:
    """Nodes of a participant that has left, or has not come yet, are not listed."""
    t = Table()
    t.table.apply([nodes(P1, NodeEntities("/early"))])
    assert t.table.nodes() == {}
    t.table.apply([Joined(P1)])
    assert set(t.table.nodes()) == {"/early"}
    t.table.apply([Gone("participant", 0, P1)])
    t.table.apply([nodes(P1, NodeEntities("/late"))])
    assert t.table.nodes() == {}
    t.table.apply([nodes(bytes([i]) * 16, NodeEntities(f"/n{i}")) for i in range(200)])
    assert len(t.table._early) <= 64


async def test_nodes_change() -> None:
    """A participant's newest message replaces what it told before."""
    t = Table()
    t.table.apply([Joined(P1), nodes(P1, NodeEntities("/a"), NodeEntities("/b"))])
    t.table.apply([nodes(P1, NodeEntities("/b"), NodeEntities("/c"))])
    assert t.told == [
        "node /a has appeared",
        "node /b has appeared",
        "node /c has appeared",
        "node /a has left",
    ]
    assert set(t.table.nodes()) == {"/b", "/c"}


async def test_one_node_name_twice() -> None:
    """Two participants with nodes of one name are one entry with the endpoints of both."""
    t = Table()
    first, second = endpoint(1, "rt/a"), endpoint(2, "rt/b")
    t.table.apply([Joined(P1), Joined(P2), first, second])
    t.table.apply([nodes(P1, NodeEntities("/n", (), (first.guid,))), nodes(P2, NodeEntities("/n", (), (second.guid,)))])
    assert t.table.nodes()["/n"].publishers == (("/a", STRING), ("/b", STRING))
    t.table.close()


async def test_gid_sizes() -> None:
    """The sizes of gid in use follow the participants that are there; our own does not count."""
    t = Table()
    t.table.apply([nodes(P2, NodeEntities("/own"), local=True)])
    assert t.sizes == []
    t.table.apply([Joined(P1), nodes(P1, NodeEntities("/n"), gid_bytes=24)])
    t.table.apply([Gone("participant", 0, P1)])
    assert t.sizes == [{24}, set()]


async def test_changed_topics() -> None:
    """Topics whose publishers come, go or change are named once per batch; those of readers are not."""
    t = Table()
    t.table.apply([endpoint(1), endpoint(2), endpoint(3, "rt/u"), endpoint(4, "rt/v", kind="subscription")])
    t.table.apply([endpoint(1)])
    t.table.apply([endpoint(1, qos=QoS(depth=3))])
    t.table.apply([Gone("publisher", 3, b""), Gone("subscription", 4, b""), Gone("publisher", 99, b"")])
    assert t.changed == [{"/t", "/u"}, {"/t"}, {"/u"}]
    t.table.close()


async def test_offered() -> None:
    """Profiles to adopt are those of other gateways and nodes, of the same type."""
    t = Table("gw")
    t.table.apply(
        [
            endpoint(1, qos=QoS(depth=1)),
            endpoint(2, qos=QoS(depth=2), gateway="other"),
            endpoint(3, qos=QoS(depth=3), gateway="gw"),
            endpoint(4, qos=QoS(depth=4), local=True),
            endpoint(5, qos=QoS(depth=5), type="p::msg::dds_::Other_"),
        ]
    )
    assert [q.depth for q in t.table.offered("/t", STRING)] == [1, 2]
    assert t.table.offered("/none", STRING) == []
    assert t.table.topics()["/t"].types == (STRING, "p/msg/Other")
    t.table.close()


DDS_ADD, ADD = "pkg::srv::dds_::Add_Request_", "pkg/srv/Add"


def server(handle: int, topic: str = "rq/addRequest", type: str = DDS_ADD, **other: object) -> EndpointRecord:
    """A record of what takes requests."""
    return endpoint(handle, topic, type, "subscription", **other)


async def test_services() -> None:
    """A service is listed with who serves and who calls it while there is anybody."""
    t = Table()
    served, called = server(1, gateway="gw", since_ns=7), endpoint(2, "rq/addRequest", DDS_ADD, local=True)
    reply = endpoint(3, "rr/addReply", "pkg::srv::dds_::Add_Response_")
    t.table.apply([Joined(P1), nodes(P1, NodeEntities("/n", (served.guid,))), served, called, reply])
    assert t.table.services() == {
        "/add": ServiceInfo(
            "/add",
            (ADD,),
            (ProviderInfo("/n", "gw", gid=served.guid, since_ns=7),),
            (ProviderInfo(local=True, gid=called.guid),),
        )
    }
    assert t.table.node_of(served.guid) == "/n"
    t.table.apply([Gone("subscription", 1, served.guid)])
    assert t.table.services()["/add"].servers == ()
    t.table.apply([Gone("publisher", 2, called.guid), Gone("publisher", 3, reply.guid)])
    assert t.table.services() == {}
    assert t.changed == []
    assert t.told[-2:] == [f"node /n offers service /add ({ADD})", f"node /n no longer offers service /add ({ADD})"]


async def test_helpers_are_not_listed() -> None:
    """The endpoints that a helper makes beside ours are neither listed nor told of."""
    t = Table()
    t.table.apply([server(1, helper=True), endpoint(2, "rq/addRequest", DDS_ADD, helper=True)])
    t.table.apply([Gone("subscription", 1, b""), Gone("publisher", 2, b"")])
    assert (t.table.services(), t.told) == ({}, [])
    t.table.close()


async def test_actions() -> None:
    """An action is what takes goals, or else who publishes feedback; its parts are no topics of their own."""
    t = Table()
    goals = server(1, "rq/x/_action/send_goalRequest", "pkg::action::dds_::Go_SendGoal_Request_")
    feedback = endpoint(2, "rt/x/_action/feedback", "pkg::action::dds_::Go_FeedbackMessage_")
    user = endpoint(3, "rt/x/_action/feedback", "pkg::action::dds_::Go_FeedbackMessage_", "subscription", guid=P2)
    other = endpoint(4, "rt/y/_action/feedback", "pkg::action::dds_::Go_FeedbackMessage_")
    t.table.apply([Joined(P1), nodes(P1, NodeEntities("/n", (goals.guid,), (feedback.guid,)))])
    t.table.apply([goals, feedback, user, other, endpoint(5, "rt/x/_action/status")])
    actions = t.table.actions()
    assert [(info.name, info.type) for info in actions.values()] == [("/x", "pkg/action/Go"), ("/y", "pkg/action/Go")]
    assert actions["/x"].servers == (ProviderInfo("/n", gid=goals.guid),)
    assert actions["/x"].clients == (ProviderInfo(gid=P2),)
    assert actions["/y"].servers == (ProviderInfo(gid=other.guid),)
    assert t.table.topics() == {}
    assert t.told[1:] == ["node /n offers action /x (pkg/action/Go)"]
    t.table.close()


@pytest.mark.parametrize("first", ["ours", "theirs"])
async def test_two_of_one_name(first: str, caplog: pytest.LogCaptureFixture) -> None:
    """Another participant with a node of our name is warned of once, whoever came first."""
    ours = NodesRecord(P1, (NodeEntities("/gateway"),), 16, local=True)
    theirs = NodesRecord(P2, (NodeEntities("/gateway"), NodeEntities("/other")), 16, local=False)
    table = Table().table
    table.apply([Joined(P2)])
    for record in (ours, theirs) if first == "ours" else (theirs, ours):
        table.apply([record])
    table.apply([theirs, ours])
    assert [r.getMessage() for r in caplog.records] == [
        "dds:0: another participant is called /gateway, too; give one of the two another name"
    ]
    table.close()
