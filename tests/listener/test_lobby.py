"""ropeway.listener.lobby: connections that nobody has let in yet."""

from __future__ import annotations

import pytest

from ropeway.listener.lobby import Lobby, network_of


def enter(lobby: Lobby, host: str, dropped: list[str], name: str = "", listener: object = None) -> None:
    lobby.enter(host, listener, lambda: dropped.append(name or host))


def test_the_oldest_makes_room() -> None:
    """Where too many wait, the oldest is dropped and counted."""
    lobby, dropped = Lobby(limit=3), list[str]()
    for host in ("10.0.0.1", "10.0.0.2", "10.0.0.3", "10.0.0.4"):
        enter(lobby, host, dropped)
    assert dropped == ["10.0.0.1"]
    assert lobby.status() == {"waiting": 3, "dropped: too many": 1}


def test_one_address_pays_for_itself() -> None:
    """Where too many come from one address, its own oldest is dropped, and nobody else's."""
    lobby, dropped = Lobby(limit=100, per_address=2), list[str]()
    enter(lobby, "10.0.0.1", dropped)
    for number in range(5):
        enter(lobby, "10.0.0.9", dropped, str(number))
    assert dropped == ["0", "1", "2"]
    assert lobby.status()["dropped: too many from one address"] == 3


def test_leaving() -> None:
    """Whoever is let in, or gone, no longer counts; leaving twice is harmless."""
    lobby, dropped = Lobby(limit=2), list[str]()
    visits = [lobby.enter("10.0.0.1", None, lambda: dropped.append("")) for _ in range(2)]
    visits[0].leave()
    visits[0].leave()
    enter(lobby, "10.0.0.1", dropped)
    assert len(lobby) == 2
    assert not dropped
    for visit in visits:
        visit.leave()
    assert len(lobby) == 1


def test_a_listener_that_closes() -> None:
    """With a listener those who came to it are dropped, and no others."""
    lobby, dropped = Lobby(), list[str]()
    ours, theirs = object(), object()
    for number in range(3):
        enter(lobby, "10.0.0.1", dropped, f"ours {number}", ours)
        enter(lobby, "10.0.0.1", dropped, f"theirs {number}", theirs)
    lobby.clear(ours)
    assert dropped == ["ours 0", "ours 1", "ours 2"]
    assert len(lobby) == 3


def test_relief() -> None:
    """Where the system has no room left, the older half is dropped."""
    lobby, dropped = Lobby(), list[str]()
    for number in range(4):
        enter(lobby, "10.0.0.1", dropped, str(number))
    lobby.relieve()
    assert dropped == ["0", "1"]


@pytest.mark.parametrize(
    ("host", "network"),
    [
        ("10.0.0.1", "10.0.0.1"),
        ("::ffff:10.0.0.1", "10.0.0.1"),
        ("2001:db8:1:2:3:4:5:6", "2001:db8:1:2::/64"),
        ("fe80::1%eth0", "fe80::/64"),
        ("unknown", "unknown"),
    ],
)
def test_who_is_one_sender(host: str, network: str) -> None:
    """An IPv4 address is one sender, however it is written, and so is a whole network of 64 bits of IPv6."""
    assert network_of(host) == network
