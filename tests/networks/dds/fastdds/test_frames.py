"""The frames between a gateway and its helper."""

from __future__ import annotations

import struct

import pytest
from hypothesis import given
from hypothesis import strategies as st

from ropeway.networks.dds.fastdds import frames
from ropeway.networks.dds.fastdds.frames import BadFrame, HelperFrame, Op, Spec, Splitter, encode

some = st.builds(
    HelperFrame, st.sampled_from(Op), st.integers(0, 2**32 - 1), st.integers(0, 2**64 - 1), st.binary(max_size=200)
)


@given(st.lists(some, max_size=20), st.integers(1, 64))
def test_round_trip(sent: list[HelperFrame], step: int) -> None:
    """Frames come out as they went in, however the stream is cut."""
    stream = b"".join(map(encode, sent))
    splitter = Splitter()
    got = [frame for at in range(0, len(stream), step) for frame in splitter.feed(stream[at : at + step])]
    assert got == sent


def test_big() -> None:
    """Big frames among small ones come out whole."""
    sent = [HelperFrame(Op.CALL, 1, 2, bytes([n]) * (n * 700_000)) for n in range(1, 6)]
    stream = b"".join(map(encode, sent))
    splitter = Splitter()
    assert [f for at in range(0, len(stream), 1 << 20) for f in splitter.feed(stream[at : at + (1 << 20)])] == sent


def test_limit(monkeypatch: pytest.MonkeyPatch) -> None:
    """A body above the limit is neither sent nor waited for."""
    monkeypatch.setattr(frames, "MAX_BODY_BYTES", 10)
    with pytest.raises(BadFrame, match="11 bytes"):
        encode(HelperFrame(Op.CALL, body=bytes(11)))
    with pytest.raises(BadFrame, match="11 bytes"):
        list(Splitter().feed(struct.pack("<IBIQ", 11, 5, 0, 0)))


@given(st.lists(st.text(st.characters(exclude_characters="\0", codec="utf-8")), min_size=2, max_size=4))
def test_spec(texts: list[str]) -> None:
    """What an endpoint is for survives the way."""
    assert Spec.decode(Spec(*texts).encode()) == Spec(*texts)


@given(st.binary(max_size=40))
def test_bad_spec(body: bytes) -> None:
    """Other bytes are refused, or describe some endpoint."""
    try:
        assert Spec.decode(body).service is not None
    except BadFrame as error:
        assert "do not describe" in str(error)
