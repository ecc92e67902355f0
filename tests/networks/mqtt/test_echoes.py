"""ropeway.networks.mqtt.echoes: what a broker sends back."""

from __future__ import annotations

from ropeway.networks.mqtt.echoes import Echoes


def test_once_each() -> None:
    """What was sent comes back once for each time, and then is somebody else's."""
    echoes = Echoes()
    assert not echoes.is_own("t", b"a")
    echoes.sent("t", b"a")
    echoes.sent("t", b"a")
    echoes.sent("u", b"a")
    assert [echoes.is_own("t", b"a") for _ in range(3)] == [True, True, False]
    assert not echoes.is_own("t", b"b")
    echoes.clear()
    assert not echoes.is_own("u", b"a")


def test_bounded() -> None:
    """Of very many only the last are remembered."""
    echoes = Echoes()
    for number in range(10_000):
        echoes.sent("t", b"%d" % number)
    assert len(echoes._sent) == 4096
    assert echoes.is_own("t", b"9999")
    assert not echoes.is_own("t", b"0")
