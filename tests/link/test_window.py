"""ropeway.link.window: what the kernel tells of a TCP connection, and how much may be on the way."""

from __future__ import annotations

import socket
from collections.abc import Iterator

import pytest

from ropeway.link.window import Window, tcp_info
from tests.until import until


@pytest.fixture
def pair() -> Iterator[tuple[socket.socket, socket.socket]]:
    """Two ends of a TCP connection."""
    with socket.create_server(("127.0.0.1", 0)) as server:
        near = socket.create_connection(server.getsockname())
        far, _ = server.accept()
    with near, far:
        yield near, far


async def test_what_the_kernel_tells(pair: tuple[socket.socket, socket.socket]) -> None:
    """Bytes that came are counted by the kernel before anybody reads them, and a round trip is known."""
    near, far = pair
    before = tcp_info(far)
    assert before is not None
    near.sendall(b"x" * 1000)
    await until(lambda: (now := tcp_info(far)) is not None and now.bytes_received - before.bytes_received == 1000)
    info = tcp_info(near)
    assert info is not None
    assert 0 < info.min_rtt_s < 0.1
    assert 0 < info.rtt_s < 0.1


def test_no_tcp() -> None:
    """What is no TCP socket, or none any more, has no figures and no window."""
    datagram = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
    assert tcp_info(datagram) is None
    datagram.close()
    for sock in (None, datagram):
        assert tcp_info(sock) is None
        window = Window(sock)
        assert window.outstanding() is None
        window.fit(1e6)
        assert window.limit is None


async def test_outstanding(pair: tuple[socket.socket, socket.socket]) -> None:
    """What the peer has not acknowledged is counted: nothing at first, all that it leaves in its buffers."""
    near, far = pair
    window = Window(near)
    assert window.outstanding() == 0
    near.setblocking(False)
    sent = 0
    with pytest.raises(BlockingIOError):
        while True:
            sent += near.send(bytes(65536))
    left = window.outstanding()
    assert left is not None
    assert 0 < left < sent
    while sent:
        sent -= len(far.recv(1 << 20))
    await until(lambda: window.outstanding() == 0)


def test_fits_the_pace(pair: tuple[socket.socket, socket.socket]) -> None:
    """A slow link has a small window, a faster one a wider, step by step; the fastest is left to the kernel."""
    window = Window(pair[0])
    assert window.limit is not None
    limits = []
    for pace in (1e5, 2e8):
        for _ in range(10):
            window.fit(pace)
        limits.append(window.limit)
    assert limits[0] == max(8 * 1024, 2 * window.late_bytes), "what a receiver may acknowledge late must not fill it"
    assert limits[1] is not None
    assert limits[0] < limits[1] < 1 << 20
    window.fit(1e12)
    assert window.limit is not None, "a burst is no pace yet"
    for _ in range(20):
        window.fit(1e12)
    assert window.limit is None


def test_grows(pair: tuple[socket.socket, socket.socket]) -> None:
    """A link that ran empty is allowed more each time, until the kernel decides."""
    window = Window(pair[0])
    limits = [window.limit]
    while window.limit is not None:
        window.grow()
        limits.append(window.limit)
    finite = [limit for limit in limits if limit is not None]
    assert finite == sorted(finite)
    assert len(limits) < 20
    window.grow()
    assert window.limit is None
    again = Window(pair[0])
    again.release()
    assert again.limit is None
