"""ropeway.gateway.process.ports."""

from __future__ import annotations

import socket
from collections.abc import Iterator

import pytest

from ropeway.errors import ConnectFailed
from ropeway.gateway.process.ports import check_free


@pytest.fixture
def shared() -> Iterator[int]:
    """A port that a process listens on and would share."""
    with socket.socket() as listener:
        listener.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEPORT, 1)
        listener.bind(("127.0.0.1", 0))
        listener.listen()
        yield listener.getsockname()[1]


async def test_shared_ports_are_not_free(shared: int) -> None:
    """A port that another process shares is taken, on its address and on all of them."""
    for host in ("127.0.0.1", "0.0.0.0"):
        with pytest.raises(ConnectFailed, match="is another gateway running") as failed:
            await check_free([f"ws://{host}:{shared}"])
        assert not failed.value.retryable


async def test_free_ports() -> None:
    """A port that nobody listens on is free, and stays so; 0 is any port."""
    with socket.socket() as once:
        once.bind(("127.0.0.1", 0))
        port = once.getsockname()[1]
    for _ in range(2):
        await check_free([f"ws://127.0.0.1:{port}", "iort://127.0.0.1:0", f"wss://[::1]:{port}"])


async def test_hosts_that_are_not_ours() -> None:
    """An address that this machine does not have is told as such."""
    with pytest.raises(ConnectFailed, match="cannot listen"):
        await check_free(["ws://192.0.2.1:9090"])
