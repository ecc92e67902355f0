"""The server of viewers: what it offers, whom it lets in, and how it ends."""

from __future__ import annotations

import pytest

from ropeway.errors import ConnectFailed
from ropeway.listener.authentication import Door
from ropeway.networks.foxglove.settings import FoxgloveSettings
from tests.networks.foxglove.viewer import Sight, Viewer
from tests.support.messages import STRING, joined
from tests.support.until import until


async def test_what_is_left_out(dark: Sight) -> None:
    """Parts of the protocol that are left out are not offered, and who uses them is told so."""
    await dark.start(FoxgloveSettings(capabilities=frozenset(("services", "assets"))))
    viewer = await dark.viewer()
    assert (await viewer.op("serverInfo"))["capabilities"] == ["services"]
    for operation in (
        {"op": "advertise", "channels": []},
        {"op": "getParameters", "parameterNames": []},
        {"op": "subscribeParameterUpdates", "parameterNames": []},
        {"op": "subscribeConnectionGraph"},
    ):
        viewer.send(operation)
        assert "does not offer" in await viewer.complaint()
    await viewer.passed()
    assert len(dark.server) == 1


async def test_subprotocols(sight: Sight) -> None:
    """Only who speaks the protocol comes in."""
    async with Viewer(sight.port, subprotocol="chat.v1") as stranger:
        assert stranger.status.startswith("HTTP/1.1 400")
    assert len(sight.server) == 0


async def test_no_more_than_the_limit(dark: Sight) -> None:
    """As many viewers are let in as the door has room for, and another one once one has left."""
    await dark.start(door=Door(max_clients=1))
    first = await dark.viewer()
    await first.op("serverInfo")
    async with Viewer(dark.port) as second:
        assert second.status.startswith("HTTP/1.1 503")
    first.abort()
    await until(lambda: len(dark.server) == 0)
    third = await dark.viewer()
    await third.op("serverInfo")


async def test_an_address_that_is_taken(sight: Sight) -> None:
    """An address that cannot be bound, or TLS without a certificate, is told when the server is to listen."""
    with pytest.raises(ConnectFailed, match=str(sight.port)):
        await sight.server.listen(f"foxglove://127.0.0.1:{sight.port}")
    with pytest.raises(ConnectFailed, match="certificate"):
        await sight.server.listen("foxgloves://127.0.0.1:0")


async def test_a_session_that_fails(sight: Sight, caplog: pytest.LogCaptureFixture) -> None:
    """A fault in one session closes that one (1011), and the others are served as ever."""
    good, bad = await sight.viewer(), await sight.viewer()
    await good.op("serverInfo")
    await bad.op("serverInfo")
    _, broken = sight.server.sessions

    def fail() -> None:
        raise RuntimeError("broken")

    broken.publications.tick = fail  # type: ignore[method-assign]
    sight.server._tick_all()
    await until(lambda: len(sight.server) == 1)
    assert "the session failed" in caplog.text
    await good.passed()


async def test_the_end(sight: Sight) -> None:
    """A server that stops says so (1001), and takes back what its viewers had."""
    publisher = await sight.robot.create_publisher("/a", STRING)
    viewer = await sight.viewer()
    await viewer.subscribe("/a")
    await joined(publisher)
    await sight.server.close()
    await until(lambda: publisher.subscribers == 0)
    assert (len(sight.server), sight.server.listeners) == (0, [])
