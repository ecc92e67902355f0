"""The step that renames coordinate frames, so that robots that are alike can share a picture."""

from __future__ import annotations

from collections.abc import Callable

from ropeway.delivery.pipeline import Drop, Step
from ropeway.errors import TypesError
from ropeway.graph.base import Sample
from ropeway.types import TypeRegistry
from ropeway.types.frame_names import FrameNames
from ropeway.types.frames import frame_renamer

__all__ = ["frame_step"]


def frame_step(registry: TypeRegistry, type: str, names: FrameNames) -> Step:
    """Make the step for a topic of ``type``. A message whose frames cannot be renamed does not pass: under their old
    names they would be another robot's.
    """
    rename: Callable[[bytes], bytes] | None = None
    version = -1

    def step(sample: Sample) -> Sample | Drop:
        nonlocal rename, version
        try:
            if rename is None or version != registry.changes:
                rename, version = frame_renamer(registry, type, names), registry.changes
            payload = rename(sample.payload)
        except TypesError:
            return Drop.FRAMES
        if payload is sample.payload:
            return sample
        return Sample(payload, sample.type, sample.stamp_ns, sample.origin, sample.seq, sample.relayed, sample.sent_ns)

    return step
