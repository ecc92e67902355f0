"""ropeway.networks.overlay.links: links are made anew where Zenoh fails."""

from __future__ import annotations

import pytest

from ropeway.networks.overlay.graph import OverlayGraph
from ropeway.networks.overlay.node import OverlayNode
from tests.networks.overlay.conftest import Site
from tests.networks.overlay.fleet import member
from tests.support.messages import STRING
from tests.support.until import PATIENCE_S, until


async def test_coming_as_another_one_leaves(site: Site) -> None:
    """A member that comes in the moment in which another one leaves finds those that are there."""
    graph = await site.join()
    await graph.create_subscription("/x", STRING, None, lambda _: None)
    for identity in [member("guest") for _ in range(3)]:
        guest = OverlayGraph(OverlayNode(identity, routers=[site.endpoint], listen=()))
        await guest.open()
        publisher = await guest.create_publisher("/x", STRING)
        await until(lambda: publisher.subscribers, 40)  # noqa: B023
        await guest.close()


async def test_a_session_that_answers_nothing(site: Site, caplog: pytest.LogCaptureFixture) -> None:
    """A session in which not even a member's own answers come any more is made anew, and not again at once."""
    graph, other = await site.join(), await site.join()
    links = graph.node.links
    for _ in range(2):
        assert not links.heard(0)
    before = links.fabric.session
    await links.mend(None)
    assert links.fabric.session is not before
    for _ in range(2):
        links.heard(0)
    now = links.fabric.session
    await links.mend(None)
    assert links.fabric.session is now
    assert sum("Zenoh has stopped answering" in message for message in caplog.messages) == 1
    await other.create_publisher("/late", STRING)
    await until(lambda: "/late" in graph.topics())


async def test_asking_while_links_are_made_anew(site: Site) -> None:
    """While the session is made anew, nobody answers and there is no link, and neither is an error."""
    graph = await site.join()
    fabric = graph.node.links.fabric
    async with fabric._changing:
        await fabric._stop()
        assert await fabric.ask("rw/crl", b"", 0.05) == []
        assert not await fabric.linked(0.05)
        await fabric._start()
    assert await fabric.linked(PATIENCE_S)
    await until(lambda: graph.node.links.unlinked == "")
