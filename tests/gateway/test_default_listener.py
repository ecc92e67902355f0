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


async def test_a_gateway_that_only_dials() -> None:
    """A gateway that dials out and does not say where to listen opens no port, and is ready without."""
    made = config.parse({"gateway": {"graphs": ["memory:dials"]}, "remotes": [REMOTE]})
    assert made.gateway.listen == ()
    assert config.parse(made.to_json()).gateway.listen == ()
    async with Gateway(made) as gateway:
        assert gateway.missing() == []
        assert gateway.status()["listen"] == []


@pytest.mark.parametrize("remotes", [[], [{**REMOTE, "active": False}]])
async def test_a_gateway_with_nobody_to_dial(remotes: list[dict[str, Any]]) -> None:
    """With nobody to dial a gateway listens on this machine alone, since there would be nothing else to do."""
    made = config.parse({"gateway": {"graphs": ["memory:dials"]}, "remotes": remotes})
    assert made.gateway.listen == ("ws://127.0.0.1:9090",)


async def test_a_listener_that_was_asked_for(taken: str) -> None:
    """A listener that the configuration names must be had."""
    made = config.parse({"gateway": {"graphs": ["memory:listens"], "listen": [taken]}, "remotes": [REMOTE]})
    with pytest.raises(ConnectFailed, match="cannot listen"):
        async with Gateway(made):
            pass
