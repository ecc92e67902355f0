"""Who published a message."""

from __future__ import annotations

from ropeway.networks.ros2.origins import Origins
from tests.support.messages import STRING

from .test_discovery import Table, both, end, picture


def test_origin_of_gid() -> None:
    """Where the middleware tells the publisher's gid with a message, that is the origin."""
    origins = Origins("rmw_fastrtps_cpp", Table().discovery)
    assert origins.of("/a", STRING, b"g" * 16, lambda: 1) == (b"g" * 16, False)


def test_own_messages() -> None:
    """Messages of our own publishers, and of our gateway's other processes, are not to be heard."""
    table = Table("us")
    table.see(picture(both(end("/a", 1, gateway="us"), end("/a", 2))))
    origins = Origins("rmw_fastrtps_cpp", table.discovery)
    origins.add_own(b"o" * 16)
    assert origins.of("/a", STRING, b"o" * 16, lambda: 2) is None
    assert origins.of("/a", STRING, b"\1" * 16, lambda: 2) is None
    assert origins.of("/a", STRING, b"\2" * 16, lambda: 2) is not None


def test_origin_of_number() -> None:
    """Where it tells a number of this process, the only publisher it can stand for is the origin, from then on."""
    table = Table()
    table.see(picture(end("/a", 1)))
    origins = Origins("rmw_cyclonedds_cpp", table.discovery)
    assert origins.of("/a", STRING, b"n1", lambda: 1) == (b"\1" * 16, False)
    table.see(picture(both(end("/a", 1), end("/a", 2))))
    assert origins.of("/a", STRING, b"n1", lambda: 2) == (b"\1" * 16, False)
    assert origins.of("/a", STRING, b"n2", lambda: 2) == (b"\2" * 16, False)


def test_origin_unknown() -> None:
    """Of several publishers, or one too many matched, the origin stays unknown until it can be told."""
    table = Table()
    table.see(picture(both(end("/a", 1), end("/a", 2))))
    origins = Origins("rmw_cyclonedds_cpp", table.discovery)
    assert origins.of("/a", STRING, b"n1", lambda: 2) == (b"n1", True)
    table.see(picture(end("/a", 1)))
    assert origins.of("/a", STRING, b"n1", lambda: 2) == (b"n1", True)
    assert origins.of("/a", STRING, b"n1", lambda: 1) == (b"\1" * 16, False)
