"""Sessions of browsers."""

from __future__ import annotations

from ropeway.dashboard.viewers import SESSION_S, Viewers
from ropeway.limits import DASHBOARD_SESSIONS


def test_a_session_begins_and_ends() -> None:
    """A secret leads to its session until that is ended or too old; then its pages do no more."""
    now = 0.0
    viewers = Viewers(clock=lambda: now)
    first, second = viewers.begin(None), viewers.begin("token")
    found = viewers.find(first)
    assert found is not None
    assert found.token is None
    viewers.end(first)
    assert viewers.find(first) is None
    assert not found.active
    other = viewers.find(second)
    assert other is not None
    assert other.token == "token"
    now = SESSION_S + 1
    assert viewers.find(second) is None
    assert not other.active
    assert viewers.find("") is None


def test_sessions_are_bounded() -> None:
    """Where too many log in, the first ones are out."""
    viewers = Viewers()
    secrets = [viewers.begin(None) for _ in range(DASHBOARD_SESSIONS + 5)]
    assert viewers.find(secrets[4]) is None
    assert viewers.find(secrets[5]) is not None


def test_the_key() -> None:
    """Each dashboard has a key of its own unless one is given, and an open one asks for none."""
    assert Viewers().key != Viewers().key
    assert Viewers("abc").is_key("abc")
    assert not Viewers("abc").is_key("ab\N{GREEK SMALL LETTER GAMMA}")
    assert Viewers(open=True).find("") is not None
