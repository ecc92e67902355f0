"""ropeway.delivery.pacing.tcp: what the kernel tells of a TCP connection."""

from __future__ import annotations

import socket
from collections.abc import Iterator

import pytest

from ropeway.delivery.pacing.tcp import Tcp, tcp_info
from tests.support.until import until


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
    """What is no TCP socket, or none any more, has no figures, and nothing can be set on it."""
    datagram = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
    assert tcp_info(datagram) is None
    datagram.close()
    for sock in (None, datagram):
        assert tcp_info(sock) is None
        tcp = Tcp(sock)
        assert tcp.read() is None
        tcp.pace(1e6)
        assert tcp.congestion == ""
        assert not tcp.use_congestion("reno")


async def test_a_reading(pair: tuple[socket.socket, socket.socket]) -> None:
    """What the peer has not acknowledged counts as on the way or unsent, and as delivered once it has."""
    near, far = pair
    tcp = Tcp(near)
    first = tcp.read()
    assert first is not None
    assert first.in_flight_bytes == first.unsent_bytes == 0
    near.setblocking(False)
    sent = 0
    with pytest.raises(BlockingIOError):
        while True:
            sent += near.send(bytes(65536))
    full = tcp.read()
    assert full is not None
    assert 0 < full.unsent_bytes < sent
    assert full.delivered_bytes - first.delivered_bytes + full.in_flight_bytes + full.unsent_bytes <= sent
    left = sent
    while left:
        left -= len(far.recv(1 << 20))

    def arrived() -> bool:
        now = tcp.read()
        return now is not None and now.delivered_bytes - first.delivered_bytes == sent and not now.in_flight_bytes

    await until(arrived)


def test_congestion_control(pair: tuple[socket.socket, socket.socket]) -> None:
    """A connection changes to a congestion control that the kernel has, and to no other."""
    tcp = Tcp(pair[0])
    assert tcp.use_congestion("reno")
    assert tcp.congestion == "reno"
    assert not tcp.use_congestion("nonsense")
    assert tcp.congestion == "reno"


def test_bearing_losses(pair: tuple[socket.socket, socket.socket]) -> None:
    """A connection bears losses from when it is told so, also a second time, until it is to be steady."""
    tcp = Tcp(pair[0])
    assert tcp.use_congestion("reno")
    for _ in range(2):
        tcp.bear_losses()
        assert tcp.congestion in ("bbr", "reno")  # where the kernel has no bbr, it keeps what it had
    tcp.stay_steady()
    assert tcp.congestion in ("cubic", "reno")


def test_sending_again_soon(pair: tuple[socket.socket, socket.socket]) -> None:
    """What is lost is sent again sooner than usual where the kernel lets us say so, and all else stays as it was."""
    near, far = pair
    Tcp(near).retransmit_soon()
    near.sendall(b"whole")
    assert far.recv(5) == b"whole"


def test_forgets_losses(pair: tuple[socket.socket, socket.socket]) -> None:
    """A connection that starts again has the congestion control that it had."""
    tcp = Tcp(pair[0])
    assert tcp.use_congestion("reno")
    tcp.start_again()
    assert tcp.congestion == "reno"
