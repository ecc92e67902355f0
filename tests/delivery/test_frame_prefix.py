"""ropeway.delivery.frame_prefix: the step that renames frames."""

from __future__ import annotations

from ropeway.delivery.frame_prefix import frame_step
from ropeway.delivery.pipeline import Drop
from ropeway.graph.base import Sample
from ropeway.types import TypeRegistry
from ropeway.types.frame_names import FrameNames

IMAGE = "sensor_msgs/msg/Image"
NAMES = FrameNames("robot1/")


def test_all_else_stays() -> None:
    """A renamed message keeps its stamps, its origin and its number; one that keeps its names stays itself."""
    registry = TypeRegistry()
    step = frame_step(registry, IMAGE, NAMES)
    codec = registry.codec(IMAGE)
    sample = Sample(codec.from_json({"header": {"frame_id": "c"}}), IMAGE, 5, bytes(range(16)), 7, True, 3)
    renamed = step(sample)
    assert isinstance(renamed, Sample)
    assert codec.decode(renamed.payload)["header"]["frame_id"] == "robot1/c"
    for attribute in ("type", "stamp_ns", "origin", "seq", "relayed", "sent_ns"):
        assert getattr(renamed, attribute) == getattr(sample, attribute)
    assert step(renamed) is renamed


def test_what_cannot_be_renamed() -> None:
    """A message that is no message, or of a type that nobody knows, does not pass; once the type is known, it does."""
    registry = TypeRegistry()
    broken = Sample(b"\0\1\0\0", IMAGE, 0, bytes(16), 0)
    assert frame_step(registry, IMAGE, NAMES)(broken) is Drop.FRAMES
    step = frame_step(registry, "own/msg/Own", NAMES)
    sample = Sample(b"\0\1\0\0\2\0\0\0a\0", "own/msg/Own", 0, bytes(16), 0)
    assert step(sample) is Drop.FRAMES
    registry.add_text("own/msg/Own", "string frame_id\n")
    renamed = step(sample)
    assert isinstance(renamed, Sample)
    assert registry.codec("own/msg/Own").decode(renamed.payload) == {"frame_id": "robot1/a"}
