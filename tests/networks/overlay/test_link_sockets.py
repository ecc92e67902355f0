from __future__ import annotations

import socket

import pytest

from ropeway.delivery.pacing.tcp import Tcp, tcp_info
from ropeway.networks.overlay.link_sockets import Losses, set_options


@pytest.mark.parametrize(("family", "host"), [(socket.AF_INET, "127.0.0.1"), (socket.AF_INET6, "::1")])
def test_limit(family: socket.AddressFamily, host: str) -> None:
    """The connection between two locators gets the limit, and no other does."""
    with socket.create_server((host, 0), family=family) as server:
        ends = [socket.create_connection(server.getsockname()[:2]) for _ in range(2)]
        far = [server.accept()[0] for _ in range(2)]
        try:
            shown = f"[{host}]" if ":" in host else host
            source = f"tls/{shown}:{ends[0].getsockname()[1]}"
            target = f"tls/{shown}:{server.getsockname()[1]}"
            assert set_options(source, target, 1234)
            options = [end.getsockopt(socket.IPPROTO_TCP, socket.TCP_USER_TIMEOUT) for end in (*ends, *far)]
            assert options == [1234, 0, 0, 0]
        finally:
            for end in (*ends, *far):
                end.close()


def test_no_such_link() -> None:
    """What is no TCP connection of this process is left alone."""
    assert not set_options("tls/127.0.0.1:1", "tls/127.0.0.1:2", 1000)
    assert not set_options("quic/127.0.0.1:1", "quic/127.0.0.1:2", 1000)
    assert not set_options("nonsense", "", 1000)


def test_nothing_lost() -> None:
    """A connection that loses nothing keeps its congestion control; a look at one that is gone does nothing."""
    losses = Losses()
    with socket.create_server(("127.0.0.1", 0)) as server:
        near = socket.create_connection(server.getsockname())
        far, _ = server.accept()
        link = f"tls/127.0.0.1:{near.getsockname()[1]}", f"tls/127.0.0.1:{server.getsockname()[1]}?prio=0-4"
        with near, far:
            set_options(*link, 1000)
            used = Tcp(near).congestion
            near.sendall(bytes(200_000))
            losses.look({link})
            info = tcp_info(near)
            assert info is not None
            # A busy machine sends again what is only late.
            assert Tcp(near).congestion == used or info.bytes_sent_again > 0
    losses.look({link})
