"""ropeway.networks.zenoh.qos_text: profiles as tokens have them."""

from __future__ import annotations

import pytest
from hypothesis import given
from hypothesis import strategies as st

from ropeway.limits import QOS_DEPTH_SAMPLES
from ropeway.networks.zenoh.qos_text import parse_qos, qos_text
from ropeway.qos import LATCHED, SENSOR_DATA, QoS

_durations = st.one_of(st.none(), st.integers(1, 10**15).map(lambda ns: ns / 1e9))
_profiles = st.builds(
    QoS,
    st.sampled_from(["reliable", "best_effort"]),
    st.sampled_from(["volatile", "transient_local"]),
    st.sampled_from(["keep_last", "keep_all"]),
    st.integers(0, QOS_DEPTH_SAMPLES),
)


@given(_profiles)
def test_round_trip(qos: QoS) -> None:
    """A profile is read as it was written."""
    assert parse_qos(qos_text(qos)) == qos


@given(_durations, _durations)
def test_durations(deadline_s: float | None, lifespan_s: float | None) -> None:
    """Durations survive to the nanosecond, as far as a float holds them."""
    found = parse_qos(qos_text(QoS(deadline_s=deadline_s, lifespan_s=lifespan_s)))
    assert found is not None
    assert found.deadline_s == pytest.approx(deadline_s)
    assert found.lifespan_s == pytest.approx(lifespan_s)


@pytest.mark.parametrize(
    ("text", "qos"),
    [
        ("::,10:,:,:,,", QoS()),
        ("2::,5:,:,:,,", SENSOR_DATA),
        (":1:,1:,:,:,,", LATCHED),
        ("::,:,:,:,,", QoS(depth=42)),
        ("::2,:,:,:,,", QoS(history="keep_all", depth=42)),
        ("::,10:0,500000000:3,0:1,9223372036,854775807", QoS(deadline_s=0.5, lifespan_s=3.0)),
        ("::,10:9223372036,854775807:0,0:,,", QoS()),
        ("::,99999999999999999999:,:,:,,", QoS(depth=QOS_DEPTH_SAMPLES)),
    ],
)
def test_read(text: str, qos: QoS) -> None:
    """Profiles that rmw_zenoh writes are read; what is left out has the default of rmw_zenoh."""
    assert parse_qos(text) == qos


@pytest.mark.parametrize(
    "text",
    [
        "",
        "::",
        "9::,10:,:,:,,",
        "::,-1:,:,:,,",
        "::,x:,:,:,,",
        "::10:,:,:,,",
        "::,10:,:,:,",
        "::,1:,:,:7,,",
        "::,²:,:,:,,",
    ],
)
def test_refused(text: str) -> None:
    """What is no profile is refused, whatever is wrong with it."""
    assert parse_qos(text) is None
    assert parse_qos(f"::,{'9' * 21}:,:,:,,") is None


@given(st.text(alphabet="0123456789:,-x", max_size=60))
def test_any_text(text: str) -> None:
    """Any text is a profile or none; it raises nothing."""
    parse_qos(text)
