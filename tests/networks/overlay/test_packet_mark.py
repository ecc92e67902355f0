"""What stands beside a packet."""

from __future__ import annotations

import pytest

from ropeway.networks.overlay.packet_mark import Mark


@pytest.mark.parametrize("mark", [Mark(4, 17), Mark(7, 1 << 63, 4096, 300_000)])
def test_read_back(mark: Mark) -> None:
    """A mark is read as it was made, whole packet or part."""
    assert Mark.read(mark.to_bytes()) == mark


@pytest.mark.parametrize("raw", [b"", b"\1", b"\2" + Mark(1, 2).to_bytes()[1:], b"\1\10" + bytes(8), bytes(26)])
def test_unknown(raw: bytes) -> None:
    """Whatever else stands beside a packet is no mark."""
    assert Mark.read(raw) is None
