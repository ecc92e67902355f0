"""Routers."""

from __future__ import annotations

from contextlib import AsyncExitStack
from pathlib import Path

import pytest
from cryptography.hazmat.primitives.serialization import Encoding

from ropeway.errors import GraphUnavailable, IdentityError
from ropeway.networks.overlay.fleet import Fleet
from ropeway.networks.overlay.graph import OverlayGraph
from ropeway.networks.overlay.node import OverlayNode
from ropeway.networks.overlay.router import Router, push_crl
from ropeway.qos import QoS
from tests.networks.overlay.fleet import member
from tests.support.inbox import Inbox
from tests.support.messages import STRING
from tests.support.messages import sample as text
from tests.support.ports import free_endpoint
from tests.support.until import until


async def test_a_mesh(tmp_path: Path) -> None:
    """Messages cross two routers; a revocation told to one reaches all, cuts the member off and outlives a restart."""
    made = Fleet.create("mesh", tmp_path / "mesh")
    one, two = free_endpoint(), free_endpoint()
    identities = [made.issue(f"router{number}", role="router") for number in (1, 2)]
    state = tmp_path / "state.crl"
    said: list[str] = []
    async with AsyncExitStack() as stack:
        first = Router(identities[0], listen=[one], look_s=0.2, on_change=said.append)
        second = Router(identities[1], listen=[two], connect=[one], look_s=0.2, state=state)
        for router in (first, second):
            await stack.enter_async_context(router)
        graphs = []
        for name, where in (("near", one), ("far", two)):
            graph = OverlayGraph(OverlayNode(made.issue(name), routers=[where], listen=()))
            await graph.open()
            stack.push_async_callback(graph.close)
            graphs.append(graph)
        near, far = graphs
        inbox = Inbox()
        await far.create_subscription("/a", STRING, QoS(), inbox)
        publisher = await near.create_publisher("/a", STRING)
        await until(lambda: publisher.subscribers)
        publisher.publish(text("x"))
        await inbox.wait(1)
        assert near.node.path(far.node.gateway) == "routed"
        assert len(first.status()["links"]) >= 2
        made.revoke("far")
        assert await push_crl(made.issue("operator"), made.crl_der(), routers=[one]) >= 1
        await until(lambda: not publisher.subscribers)
        await until(lambda: second.status()["denied"] == ["far"] and first.status()["denied"] == ["far"])
        assert any("denies far" in text for text in said)
        assert state.read_bytes() == made.crl_der()
    again = Router(identities[1], listen=[two], state=state)
    async with again:
        assert again.status()["denied"] == ["far"]


async def test_list_from_a_file(tmp_path: Path) -> None:
    """A revocation list in a file is read when it changes."""
    made = Fleet.create("file", tmp_path / "file")
    made.issue("robot")
    made.issue("other")
    identity = made.issue("router", role="router")
    async with Router(identity, listen=[free_endpoint()], look_s=0.05, crl=tmp_path / "file" / "crl.pem") as router:
        made.revoke("robot")
        await until(lambda: router.status()["denied"] == ["robot"])
        (tmp_path / "file" / "crl.pem").write_text("junk")
        made.revoke("other")
        await until(lambda: router.status()["denied"] == ["other", "robot"])


async def test_routers_only() -> None:
    """A member's bundle makes no router, and a place that is taken is said."""
    with pytest.raises(IdentityError, match="keys issue NAME --router"):
        Router(member(), listen=[free_endpoint()])
    where = free_endpoint()
    async with Router(member("r", role="router"), listen=[where]):
        with pytest.raises(GraphUnavailable, match="Zenoh cannot start"):
            async with Router(member("r", role="router"), listen=[where]):
                pass


async def test_nobody_to_push_to() -> None:
    """A revocation list that reaches no router says which were tried."""
    where = free_endpoint()
    operator = member("operator")
    with pytest.raises(GraphUnavailable, match=where.replace(".", "[.]")):
        await push_crl(operator, operator.crl, routers=[where], link_s=0.5)


def test_lists_are_der(tmp_path: Path) -> None:
    """What is pushed is the list of the fleet as it stands."""
    made = Fleet.create("der", tmp_path / "der")
    assert made.crl_der() == made.crl.public_bytes(Encoding.DER)
