"""ropeway.networks.overlay.router_probe: why no router can be reached."""

from __future__ import annotations

import asyncio
from pathlib import Path

import pytest

from ropeway.errors import GraphUnavailable
from ropeway.networks.overlay.fleet import Fleet
from ropeway.networks.overlay.graph import OverlayGraph
from ropeway.networks.overlay.links import Links
from ropeway.networks.overlay.node import OverlayNode
from ropeway.networks.overlay.router_probe import unreachable
from tests.networks.overlay.conftest import Site
from tests.networks.overlay.fleet import member
from tests.support.ports import free_endpoint
from tests.support.until import until


async def test_reasons(site: Site, tmp_path: Path) -> None:
    """It is said of each router whether nobody is there, another fleet, something that is no router, or no answer."""
    robot, nobody = member(), free_endpoint()
    assert "Connect call failed" in await unreachable(robot, [nobody]) or "refused" in await unreachable(
        robot, [nobody]
    )
    stranger = Fleet.create("other", tmp_path / "other").issue("robot")
    assert "is it of another fleet?" in await unreachable(stranger, [site.endpoint])

    def greet(_: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        writer.write(b"hello")
        writer.close()

    plain = await asyncio.start_server(greet, "127.0.0.1", 0)
    port = plain.sockets[0].getsockname()[1]
    assert "no TLS is spoken there" in await unreachable(robot, [f"tls/127.0.0.1:{port}"])
    plain.close()
    assert "name is not known" in await unreachable(robot, ["tls/no-such-host.invalid:1"])
    assert "refuses our certificate" in await unreachable(robot, [site.endpoint])
    assert "name one" in await unreachable(robot, [])


async def test_a_gateway_says_so(
    site: Site, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture, tmp_path: Path
) -> None:
    """A member that no router takes says why in its log, once, and in its status; so does what waits for a link."""
    monkeypatch.setattr(Links.__init__, "__kwdefaults__", {"link_s": 0.2})
    stranger = Fleet.create("other", tmp_path / "other").issue("robot")
    graph = OverlayGraph(OverlayNode(stranger, routers=[site.endpoint], listen=()))
    await graph.open()
    try:
        await until(lambda: graph.node.links.unlinked)
        assert "another fleet" in graph.node.status()["trouble"]
        with pytest.raises(GraphUnavailable, match="another fleet"):
            await graph.node.links.wait(0.2)
        assert sum("another fleet" in message for message in caplog.messages) == 1
    finally:
        await graph.close()
