"""ropeway.gateway.gateway: the listener that a configuration did not ask for."""

from __future__ import annotations

import socket
from collections.abc import Iterator
from typing import Any

import pytest

from ropeway.errors import ConnectFailed
from ropeway.gateway.config import config
from ropeway.gateway.gateway import Gateway

REMOTE = {"address": "ws://127.0.0.1:9", "publish": [{"name": "/t", "type": "std_msgs/msg/String"}]}


@pytest.fixture
def taken() -> Iterator[str]:
    """Have somebody listen on a port."""
    with socket.create_server(("127.0.0.1", 0)) as sock:
        yield f"ws://127.0.0.1:{sock.getsockname()[1]}"


def by_default(address: str, remotes: list[dict[str, Any]]) -> Gateway:
    """Return a gateway as if ``address`` were where all listen that are not told where."""
    made = config.parse({"gateway": {"graphs": ["memory:dials"]}, "remotes": remotes})
    assert made.gateway.listen == ("ws://127.0.0.1:9090",)
    made.gateway.__dict__["listen"] = (address,)  # and not among the fields that were set
    return Gateway(made)


async def test_a_gateway_that_only_dials(taken: str, caplog: pytest.LogCaptureFixture) -> None:
    """A gateway that only dials out goes on without a listener if the default port is taken, and says so."""
    async with by_default(taken, [REMOTE]) as gateway:
        assert gateway.missing() == []
    assert "going on without it" in caplog.text
    assert '"listen"' in caplog.text


async def test_a_gateway_with_nobody_to_dial(taken: str) -> None:
    """Without a listener, and with nobody to dial, there would be nothing: the listener must be had."""
    with pytest.raises(ConnectFailed, match="cannot listen"):
        async with by_default(taken, []):
            pass


async def test_a_listener_that_was_asked_for(taken: str) -> None:
    """A listener that the configuration names must be had."""
    made = config.parse({"gateway": {"graphs": ["memory:listens"], "listen": [taken]}, "remotes": [REMOTE]})
    with pytest.raises(ConnectFailed, match="cannot listen"):
        async with Gateway(made):
            pass
