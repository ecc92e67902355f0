"""What stands beside a packet."""

from __future__ import annotations

import pytest

from ropeway.networks.overlay.packet_mark import Mark, by_way


@pytest.mark.parametrize("mark", [Mark(4, 17), Mark(7, 1 << 63, 4096, 300_000)])
def test_read_back(mark: Mark) -> None:
    """A mark is read as it was made, whole packet or part."""
    assert Mark.read(mark.to_bytes()) == mark


@pytest.mark.parametrize("raw", [b"", b"\1", b"\2" + Mark(1, 2).to_bytes()[1:], b"\1\10" + bytes(8), bytes(26)])
def test_unknown(raw: bytes) -> None:
    """Whatever else stands beside a packet is no mark."""
    assert Mark.read(raw) is None


@pytest.mark.parametrize("mark", [Mark(4, 17), Mark(7, 1 << 63, 4096, 300_000)])
def test_by_another_way(mark: Mark) -> None:
    """A mark tells by which of its sender's ways the packet came; by the first one it is as it always was."""
    raw = mark.to_bytes()
    assert by_way(raw, 0) == raw
    assert Mark.read(by_way(raw, 3)) == mark._replace(way=3)
