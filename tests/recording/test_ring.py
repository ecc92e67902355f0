"""ropeway.recording.ring: the last seconds."""

from __future__ import annotations

from hypothesis import given
from hypothesis import strategies as st

from ropeway.limits import RECORDED_MESSAGE_BYTES
from ropeway.qos import LATCHED, QoS
from ropeway.recording.channel import Recorded, cdr_channel
from ropeway.recording.ring import Ring
from ropeway.types import TypeRegistry
from tests.support.messages import STRING

REGISTRY = TypeRegistry()
PLAIN = cdr_channel(REGISTRY, "/a", STRING, [QoS()])
KEPT = cdr_channel(REGISTRY, "/tf_static", STRING, [LATCHED, LATCHED])


def at(second: float, size: int = 1) -> Recorded:
    return Recorded(PLAIN, int(second * 1e9), bytes(size))


def test_seconds() -> None:
    """What is older than the ring goes, and nothing else."""
    ring = Ring(3.0, 1 << 20)
    for second in range(10):
        ring.add(at(second))
    assert [one.time_ns // 10**9 for one in ring.snapshot()] == [6, 7, 8, 9]
    assert ring.cut == 0


def test_latched() -> None:
    """The last messages of a latched topic stay, however old they are, and come first."""
    ring = Ring(1.0, 1 << 20)
    for second in range(3):
        ring.add(Recorded(KEPT, second * 10**9, bytes([second])))
    ring.add(at(100.0))
    ring.add(Recorded(KEPT, 101 * 10**9, b"x"))
    assert [one.payload for one in ring.snapshot()] == [b"\2", b"\0", b"x"]


@given(st.lists(st.tuples(st.floats(0, 1), st.integers(0, 5_000))), st.integers(1, 20_000))
def test_bytes(steps: list[tuple[float, int]], most: int) -> None:
    """The ring holds no more bytes than it may, but for one message, and what it holds is the newest in order."""
    ring, now_s, all_of = Ring(5.0, most), 0.0, []
    for step, size in steps:
        now_s += step
        message = at(now_s, size)
        all_of.append(message)
        ring.add(message)
        assert ring.bytes == sum(len(one.payload) + RECORDED_MESSAGE_BYTES for one in ring.snapshot())
        assert ring.bytes <= most or len(ring) == 1
        assert ring.snapshot() == all_of[len(all_of) - len(ring) :]
