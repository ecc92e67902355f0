"""CBOR with floats in full."""

from __future__ import annotations

import math

import cbor2

from ropeway.types.cbor import WideFloat, dumps, wide


def test_wide_floats_are_written_in_full() -> None:
    """NaN and infinity take 64 bits, as rosbridge sends them; all else is as cbor2 writes it."""
    assert (
        dumps({"a": wide(math.nan), "b": [wide(-math.inf)]}).hex() == "a26161fb7ff8000000000000616281fbfff0000000000000"
    )
    assert dumps([1.5, "x", b"\xf9", 7]) == cbor2.dumps([1.5, "x", b"\xf9", 7])


def test_finite_floats_stay_plain() -> None:
    """A finite float is not wrapped."""
    assert type(wide(1.0)) is float
    assert type(wide(math.inf)) is WideFloat
    assert cbor2.loads(dumps(wide(math.inf))) == math.inf
