"""ropeway.networks.overlay.crypto.cbor: what gateways tell each other is counted before it is read."""

from __future__ import annotations

import contextlib

import cbor2
import pytest
from hypothesis import given
from hypothesis import strategies as st

from ropeway.errors import SealError
from ropeway.networks.overlay.crypto.cbor import loads, pair
from ropeway.networks.overlay.refusal import Refusal
from tests.networks.overlay.hostile import peak_bytes

plain = st.recursive(
    st.none() | st.booleans() | st.integers(-(2**63), 2**64 - 1) | st.floats(allow_nan=False) | st.text() | st.binary(),
    lambda inner: st.lists(inner, max_size=5) | st.dictionaries(st.text(max_size=5), inner, max_size=5),
    max_leaves=20,
)


def refused(raw: bytes, **options: int) -> Refusal:
    with pytest.raises(SealError) as caught:
        loads(raw, "a note", **options)
    assert isinstance(caught.value.reason, Refusal)
    return caught.value.reason


@given(plain)
def test_what_gateways_make_is_read(value: object) -> None:
    """Every value of the plain kind comes back as it was, unless it is nested too deep."""
    with contextlib.suppress(SealError):
        assert loads(cbor2.dumps(value), "a note") == value
    assert loads(memoryview(cbor2.dumps([1, [2, {"a": b"b"}]])), "a note") == [1, [2, {"a": b"b"}]]


@given(st.binary(max_size=100))
def test_any_bytes(raw: bytes) -> None:
    """Any bytes are a value, or a SealError; no other exception."""
    with contextlib.suppress(SealError):
        loads(raw, "a note")


@pytest.mark.parametrize(
    "raw",
    [
        b"",
        b"\x9f\xff",  # a list without a length
        b"\x7f\xff",  # a text without one
        b"\xc2\x41\x01",  # a tag: a large number
        b"\x5b" + b"\xff" * 8,  # bytes of 2**64 - 1
        b"\x9b" + b"\xff" * 8,  # a list of 2**64 - 1
        b"\x9a\x7f\xff\xff\xff",  # a list of 2**31 - 1
        b"\xbb" + b"\x7f" * 8,
        b"\x81" * 1000 + b"\x01",
        cbor2.dumps([1, 2]) + b"\x00",
        cbor2.dumps([1, 2])[:-1],
    ],
)
def test_what_is_refused(raw: bytes) -> None:
    """Lengths that lie, depth, tags, indefinite lengths and bytes that are left over are refused."""
    assert refused(raw) is Refusal.MALFORMED


def test_many_small_values() -> None:
    """A megabyte of empty lists is refused before any of them is made; bytes of that size are no matter."""
    raw = b"\x9a\x00\x0f\xff\xfb" + b"\x80" * 0xFFFFB
    assert refused(raw) is Refusal.MALFORMED
    assert peak_bytes(lambda: loads(raw, "a note")) < 100_000
    assert loads(cbor2.dumps([bytes(1 << 20)]), "a note", items=2) == [bytes(1 << 20)]
    assert refused(cbor2.dumps([1, 2]), items=2) is Refusal.MALFORMED


def test_pair() -> None:
    """A text and its signature are two byte strings and nothing else."""
    assert pair(cbor2.dumps((b"a", b"b")), "a note") == (b"a", b"b")
    for value in (b"ab", [b"a"], [b"a", "b"], [b"a", b"b", b"c"], {b"a": b"b", b"c": b"d"}):
        with pytest.raises(SealError):
            pair(cbor2.dumps(value), "a note")
