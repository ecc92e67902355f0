"""ropeway.networks.overlay.links: links are made anew where Zenoh fails."""

from __future__ import annotations

import asyncio
from typing import Any, cast

import pytest

from ropeway.errors import GraphUnavailable
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
    before = links.main.session
    await links.mend(None)
    assert links.main.session is not before
    for _ in range(2):
        links.heard(0)
    now = links.main.session
    await links.mend(None)
    assert links.main.session is now
    assert sum("Zenoh has stopped answering" in message for message in caplog.messages) == 1
    await other.create_publisher("/late", STRING)
    await until(lambda: "/late" in graph.topics())


async def test_a_link_that_brings_nobody_back(site: Site, caplog: pytest.LogCaptureFixture) -> None:
    """Where a link that was made again brings nobody back, links are made anew once; who never had company is left."""
    graph, other = await site.join(), await site.join()
    links = graph.node.links
    links.in_company(0)
    links.in_company(1)
    before = links.main.session
    for _ in range(3):
        links.in_company(0)  # all have left
        await links.mend(None)
    links.main.connection += 1000  # as after a cut
    links.in_company(1)
    links.in_company(0)
    await links.mend(None)
    assert links.main.session is before
    links.in_company(0)
    await links.mend(None)
    assert links.main.session is not before
    assert sum("nobody is heard of" in message for message in caplog.messages) == 1
    links.main.connection += 1000
    now = links.main.session
    for _ in range(3):
        links.in_company(0)
        await links.mend(None)
    assert links.main.session is now
    await other.create_publisher("/late", STRING)
    await until(lambda: "/late" in graph.topics())


async def test_asking_while_links_are_made_anew(site: Site) -> None:
    """While the session is made anew, nobody answers and there is no link, and neither is an error."""
    graph = await site.join()
    fabric = graph.node.links.main
    async with fabric._changing:
        await fabric._stop()
        assert await fabric.ask("rw/crl", b"", 0.05) == []
        assert not await fabric.linked(0.05)
        await fabric._start()
    assert await fabric.linked(PATIENCE_S)
    await until(lambda: graph.node.links.unlinked == "")


class PanicException(BaseException):
    """What a panic of Zenoh raises: by this name, and of a class that cannot be imported."""


async def test_zenoh_panics(site: Site) -> None:
    """A panic of Zenoh is an error like others, and the session in which it happened is made anew."""
    graph = await site.join()
    node, fabric = graph.node, graph.node.links.main
    failed = fabric.session

    class Failed:
        @property
        def info(self) -> Failed:
            return self

        def routers_zid(self) -> list[str]:
            return []

        links = routers_zid

        def __getattr__(self, name: str) -> Any:
            def panic(*_: object, **__: object) -> None:
                raise PanicException(name)

            return panic

    fabric._session = cast("Any", Failed())
    with pytest.raises(GraphUnavailable, match="Zenoh has failed"):
        await fabric.ask("rw/crl", b"", 0.1)
    with pytest.raises(GraphUnavailable, match="Zenoh has failed"):
        fabric.tell("rw/h/x", b"")
    for _ in range(2):
        assert await node._ask_for_crl() == 0
    await node.links.mend(None)
    assert await node._ask_for_crl()
    await asyncio.to_thread(failed.close)


async def test_a_router_whose_session_answers_nothing(site: Site, caplog: pytest.LogCaptureFixture) -> None:
    """A router that not even hears its own answers makes its links anew, and carries on."""
    near, far = await site.join(), await site.join()
    for end in site.router._ends:
        end()
    for graph in (near, far):
        for end in graph.node._ends:
            end()
    await until(lambda: any("stopped answering" in message for message in caplog.messages))
    await until(lambda: bool(near.node.fabric.links() and far.node.fabric.links()))
    await far.create_publisher("/late", STRING)
    await until(lambda: "/late" in near.topics())
