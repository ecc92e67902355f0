"""Profiles and USER_DATA in DDS's terms."""

from __future__ import annotations

import ctypes as ct
from collections.abc import Iterator

import pytest
from hypothesis import given
from hypothesis import strategies as st

from ropeway.networks.dds import raw
from ropeway.networks.dds.endpoint_qos import parse_user_data, read_qos, reader_qos, user_data, writer_qos
from ropeway.qos import LATCHED, SENSOR_DATA, QoS

profiles = st.builds(
    QoS,
    reliability=st.sampled_from(["reliable", "best_effort"]),
    durability=st.sampled_from(["volatile", "transient_local"]),
    depth=st.integers(1, 2**31 - 1),
    deadline_s=st.none() | st.integers(1, 10**6).map(lambda ms: ms / 1000),
    lifespan_s=st.none() | st.integers(1, 10**6).map(lambda ms: ms / 1000),
)


@pytest.fixture(scope="module", autouse=True)
def library() -> Iterator[None]:
    """The functions of the library."""
    raw.load("test")
    yield


@given(profiles)
def test_writers(qos: QoS) -> None:
    """A writer's profile is read back as it was."""
    with writer_qos(qos, b"") as handle:
        assert read_qos(handle) == qos


def test_untold_history() -> None:
    """Of a vendor that does not announce the history the depth stays open."""
    with writer_qos(LATCHED, b"") as handle:
        assert read_qos(handle, tells_history=False) == QoS(durability="transient_local", depth=0)


@given(profiles)
def test_readers(qos: QoS) -> None:
    """A reader keeps what decides on matching, and tells its depth; the history that it has is deeper."""
    with reader_qos(qos, b"") as handle:
        got = read_qos(handle)
        kind, history = ct.c_int(), ct.c_int32()
        assert raw.lib.qget_history(handle, ct.byref(kind), ct.byref(history))
        assert history.value >= max(qos.depth, 1024)
    if qos.history == "keep_last":
        assert got.depth == qos.depth
    assert (got.reliability, got.durability, got.deadline_s) == (qos.reliability, qos.durability, qos.deadline_s)
    assert got.depth >= qos.depth


def test_keep_all() -> None:
    """A writer that keeps all says so, a reader is bounded."""
    qos = QoS(history="keep_all")
    with writer_qos(qos, b"") as handle:
        assert read_qos(handle).history == "keep_all"
    with reader_qos(qos, b"") as handle:
        assert read_qos(handle).depth > 1000


@pytest.mark.parametrize("qos", [QoS(depth=0), SENSOR_DATA, LATCHED])
def test_common_profiles(qos: QoS) -> None:
    """The profiles people use are valid, a depth of 0 counts as 1."""
    with writer_qos(qos, b"") as handle:
        assert read_qos(handle).depth == max(qos.depth, 1)


def test_marks() -> None:
    """What we write into USER_DATA is found there again."""
    mark = user_data(type_hash="RIHS01_ab", gateway_id="gw", extra="serviceid=01.2;")
    assert mark == b"serviceid=01.2;typehash=RIHS01_ab;ropeway=gw;"
    assert user_data() == b""
    assert user_data(gateway_id="gw", since_ns=12) == b"ropeway=gw;since=12;"
    with writer_qos(QoS(), mark) as handle:
        assert parse_user_data(handle) == {"serviceid": "01.2", "typehash": "RIHS01_ab", "ropeway": "gw"}


@given(st.binary(max_size=80))
def test_hostile_marks(mark: bytes) -> None:
    """Any USER_DATA is read as pairs or as nothing."""
    with writer_qos(QoS(), mark) as handle:
        assert all(isinstance(v, str) for v in parse_user_data(handle).values())
