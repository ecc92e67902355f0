"""ropeway.networks.overlay.known_gateway: lists of other gateways, new and old."""

from __future__ import annotations

from typing import Any

import pytest

from ropeway.errors import SealError
from ropeway.networks.overlay.known_gateway import CHALLENGE_BYTES, KnownGateway, clock_ahead_s, unreachable
from ropeway.networks.overlay.refusal import Refusal

NOW_NS = 1_800_000_000 * 10**9
HOUR_NS = 3600 * 10**9
OURS, OTHERS = bytes(CHALLENGE_BYTES), bytes([1]) * CHALLENGE_BYTES


def ahead_s(told_ns: int, challenge: bytes | None = OURS, **hello: Any) -> float:
    return clock_ahead_s({"t": told_ns, **hello}, "robot", challenge, NOW_NS)


@pytest.mark.parametrize("off_ns", [HOUR_NS, -HOUR_NS, 0])
def test_a_list_that_answers_our_challenge(off_ns: int) -> None:
    """It is new, whatever the clocks say, and tells how far they are apart; so is one from a sealed channel."""
    assert ahead_s(NOW_NS + off_ns, q=OURS) == off_ns / 10**9
    assert ahead_s(NOW_NS + off_ns, challenge=None, q=b"") == off_ns / 10**9


def test_a_list_that_answers_somebody_elses_challenge() -> None:
    """It is sent again by whoever has heard it, and refused, also if its time is right."""
    with pytest.raises(SealError, match="somebody else") as caught:
        ahead_s(NOW_NS, q=OTHERS)
    assert caught.value.reason is Refusal.REPLAYED


@pytest.mark.parametrize(("off_ns", "way"), [(HOUR_NS, "3600 s ahead of"), (-HOUR_NS, "3600 s behind")])
def test_a_list_without_a_challenge(off_ns: int, way: str) -> None:
    """Of older members the time has to fit, and the refusal says by how much it does not, and what to do."""
    assert ahead_s(NOW_NS) == 0
    assert ahead_s(NOW_NS, q=b"") == 0
    with pytest.raises(SealError, match=f"{way} ours.*set the clocks") as caught:
        ahead_s(NOW_NS + off_ns)
    assert caught.value.reason is Refusal.TOO_OLD


def test_silence() -> None:
    """A gateway that does not say who it is within some seconds is silent."""
    known = KnownGateway(unanswered=10.0)
    assert not known.silent(11.0)
    assert known.silent(20.0)
    assert not KnownGateway().silent(20.0)


def test_silence_while_others_tell_who_they_are() -> None:
    """A gateway that does not answer while others join is taken to be busy, until a minute has passed."""
    silent, joined = KnownGateway(unanswered=10.0), KnownGateway(joined=19.0)
    assert unreachable({b"silent": silent}, 20.0) == b"silent"
    assert unreachable({b"silent": silent, b"joined": joined}, 20.0) is None
    assert unreachable({b"silent": silent, b"joined": joined}, 24.0) == b"silent"
    joined.joined = 70.0
    assert unreachable({b"silent": silent, b"joined": joined}, 71.0) == b"silent"
