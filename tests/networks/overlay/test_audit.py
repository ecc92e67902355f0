"""ropeway.networks.overlay.audit: who signed a packet, for people who cannot read it."""

from __future__ import annotations

import json
import time
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st

from ropeway.networks.overlay.audit import Verdict, captured, verdicts
from ropeway.networks.overlay.crypto.seal import Sealer
from ropeway.networks.overlay.crypto.trust import Trust
from ropeway.networks.overlay.data_key import data_key
from ropeway.networks.overlay.fleet import Fleet
from ropeway.networks.overlay.refusal import Refusal
from tests.networks.overlay.fleet import fleet, member

NAME, PUBLISHER = bytes(range(32)), bytes(range(16))


@pytest.fixture(scope="module")
def line() -> str:
    """A packet of three messages that a member signed."""
    robot = member()
    packet = Sealer(NAME, PUBLISHER, robot.sign).seal([[b"one"], [b"two"], [b"three"]])
    return captured(data_key(NAME, PUBLISHER), packet, robot.certificate.der, time.time_ns())


def judged(text: str, trust: Trust | None = None) -> list[Verdict]:
    return list(verdicts(text, trust or Trust(fleet().ca)))


def test_a_packet_of_a_member(line: str) -> None:
    """Who has the fleet's certificate, and no key, is told who signed what, and how much."""
    (verdict,) = judged(line)
    assert verdict.fault == ""
    assert (verdict.name, verdict.publisher) == (NAME.hex(), PUBLISHER.hex())
    assert (verdict.first, verdict.messages) == (1, 3)
    assert verdict.member.startswith("robot")


def test_what_is_not_verified(line: str, tmp_path: Path) -> None:
    """A packet that was altered, put under another name, or signed by another fleet or a revoked member is told."""
    row = json.loads(line)
    altered = {**row, "packet": row["packet"][:-8] + "AAAAAAA="}
    renamed = {**row, "key": data_key(bytes(32), PUBLISHER)}
    for changed in (altered, renamed):
        (verdict,) = judged(json.dumps(changed))
        assert Refusal.BAD_SIGNATURE.value in verdict.fault
    (verdict,) = judged(line, Trust(Fleet.create("other", tmp_path / "other").ca))
    assert Refusal.UNKNOWN_CA.value in verdict.fault
    made = Fleet.create("mine", tmp_path / "mine")
    robot = made.issue("robot")
    packet = Sealer(NAME, PUBLISHER, robot.sign).seal([[b"one"]])
    made.revoke("robot")
    revoked = captured(data_key(NAME, PUBLISHER), packet, robot.certificate.der, time.time_ns())
    (verdict,) = judged(revoked, Trust(made.ca, made.crl_der()))
    assert Refusal.REVOKED.value in verdict.fault


@given(
    st.text(max_size=60)
    | st.dictionaries(
        st.sampled_from(["key", "packet", "certificate", "time_ns"]), st.text(max_size=20) | st.integers() | st.none()
    ).map(json.dumps)
)
def test_any_line(text: str) -> None:
    """Whatever a file holds is judged line by line, and one bad line is no matter for the others."""
    assert all(verdict.fault for verdict in judged(text))
