"""Packets that come in parts."""

from __future__ import annotations

import pytest

from ropeway.networks.overlay.held_bytes import HeldBytes
from ropeway.networks.overlay.packet_assembly import PacketAssembly
from ropeway.networks.overlay.packet_mark import Mark


def feed(parts: PacketAssembly, *pieces: tuple[int, int, bytes]) -> list[bytes | None]:
    return [parts.take(Mark(4, number, at, size), raw) for number, (at, size, raw) in enumerate(pieces, 1)]


def test_put_together() -> None:
    """The last part completes a packet, and nothing is held after it."""
    held = HeldBytes()
    parts = PacketAssembly(100, held)
    assert feed(parts, (0, 6, b"ab"), (2, 6, b"cd"), (4, 6, b"ef")) == [None, None, b"abcdef"]
    assert held.bytes == 0
    assert feed(parts, (0, 2, b"g"), (1, 2, b"h")) == [None, b"gh"]


@pytest.mark.parametrize(
    "pieces",
    [
        [(0, 6, b"ab"), (4, 6, b"ef")],  # one is missing
        [(2, 6, b"cdef")],  # the first is
        [(0, 6, b"ab"), (2, 7, b"cdef")],  # of another packet
        [(0, 4, b"ab"), (2, 4, b"cdef")],  # too long
        [(0, 101, b"a" * 101)],  # longer than any packet
        [(0, 1 << 60, b"a")],
    ],
)
def test_what_does_not_fit(pieces: list[tuple[int, int, bytes]]) -> None:
    """Parts that do not follow one another make no packet, and hold nothing."""
    held = HeldBytes()
    parts = PacketAssembly(100, held)
    assert feed(parts, *pieces)[-1] is None
    assert held.bytes == 0
    assert feed(parts, (0, 2, b"g"), (1, 2, b"h")) == [None, b"gh"]


def test_no_room() -> None:
    """A packet for which the budget has no room is lost, the next one is not."""
    held = HeldBytes(4)
    parts = PacketAssembly(100, held)
    assert feed(parts, (0, 6, b"abc"), (3, 6, b"def")) == [None, None]
    assert held.bytes == 0
    assert feed(parts, (0, 3, b"ab"), (2, 3, b"c")) == [None, b"abc"]
