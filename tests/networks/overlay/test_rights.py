"""What members may do."""

from __future__ import annotations

import pytest

from ropeway.networks.overlay.rights import EVERYTHING, Rights


def test_patterns() -> None:
    """A pattern stands for whole names, slashes included, and each verb has its own."""
    rights = Rights(publish=("/camera/*", "/odom"), call=("*",))
    assert rights.may("publish", "/camera/left/image")
    assert rights.may("publish", "/odom")
    assert not rights.may("publish", "/odom2")
    assert not rights.may("publish", "/cameras")
    assert not rights.may("subscribe", "/odom")
    assert rights.may("call", "/anything")
    assert all(EVERYTHING.may(verb, "/x/y") for verb in ("publish", "subscribe", "call", "offer"))


def test_actions() -> None:
    """The parts of an action are judged by its name: who may use it, and who may offer it."""
    user, provider = Rights(call=("/fib",)), Rights(offer=("/fib",))
    for part in ("send_goal", "cancel_goal", "get_result"):
        assert user.may("call", f"/fib/_action/{part}")
        assert provider.may("offer", f"/fib/_action/{part}")
        assert not provider.may("call", f"/fib/_action/{part}")
    assert user.may("subscribe", "/fib/_action/feedback")
    assert provider.may("publish", "/fib/_action/status")
    assert not user.may("publish", "/fib/_action/feedback")
    assert not user.may("call", "/other/_action/send_goal")


def test_round_trip() -> None:
    """What stands in a certificate is read as it was written, and anything else is refused."""
    rights = Rights(("/a",), ("/b", "*"), (), ("/c",))
    assert Rights.from_json(rights.to_json()) == rights
    for raw in (b"", b"[]", b"{", b'{"fly": ["*"]}', b'{"call": "*"}', b'{"call": [1]}'):
        with pytest.raises(ValueError):
            Rights.from_json(raw)


@pytest.mark.parametrize(
    "raw", [b"[" * 5000, b"[]", b'{"publish": 1}', b'{"publish": [1]}', b'{"drive": []}', b"\xff", b""]
)
def test_refuses_what_are_no_rights(raw: bytes) -> None:
    """An extension that holds anything else is refused, however it is made."""
    with pytest.raises(ValueError, match=r"."):
        Rights.from_json(raw)
