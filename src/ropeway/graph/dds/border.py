"""Between our layouts of types and those of a network of another distribution.

A few standard messages have changed between distributions. What is read is brought into our layout wherever it does
not fit; what is written gets the layout of the network, if its distribution was given, or is seen to be Humble or older
from the size of the gids that all its nodes write.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Final

from ropeway.errors import TypesError
from ropeway.graph.base import Sample, SampleCallback
from ropeway.types import TypeRegistry
from ropeway.types.distros import ROS2_DISTROS

__all__ = ["Border"]

_OLD: Final = "humble"  # the oldest that is still maintained, and the one that most robots have


class Border:
    """The changes of one network. ``distro`` may be ``""``; ``is_old`` tells what discovery has seen."""

    def __init__(self, registry: object, distro: str, is_old: Callable[[], bool]) -> None:
        if distro and distro not in ROS2_DISTROS:
            raise ValueError(f"{distro!r} is no distribution of ROS 2; known are {', '.join(ROS2_DISTROS)}")
        self._registry = registry if isinstance(registry, TypeRegistry) else None
        self._distro, self._is_old = distro, is_old

    @property
    def distro(self) -> str:
        """The distribution of the network, ``""`` where it may be ours."""
        return self._distro or (_OLD if self._is_old() else "")

    def inward(self, type: str, callback: SampleCallback) -> SampleCallback:
        """``callback``, given messages in our layout. What makes no sense in any is passed on as it is."""
        registry = self._registry
        if registry is None or registry.others is None or not registry.others.touches(type):
            return callback
        codec = registry.codec(type)

        def fitted(sample: Sample) -> Sample:
            try:
                payload = codec.fitting(sample.payload)
            except TypesError:
                return sample
            return sample if payload is sample.payload else _with(sample, payload)

        def passed(batch: Sequence[Sample]) -> None:
            callback([fitted(sample) for sample in batch])

        return passed

    def outward(self, type: str) -> Callable[[bytes], bytes] | None:
        """What brings a message into the layout of the network; ``None`` where no distribution has another.

        The message may be in the layout of a third one, as recordings are.
        """
        registry = self._registry
        others = None if registry is None else registry.others
        if registry is None or others is None or not others.touches(type):
            return None
        codec = registry.codec(type)

        def written(payload: bytes) -> bytes:
            convert = others.toward(type, self.distro) if self.distro else codec.fitting
            try:
                return payload if convert is None else convert(payload)
            except TypesError:
                return payload

        return written


def _with(sample: Sample, payload: bytes) -> Sample:
    return Sample(payload, sample.type, sample.stamp_ns, sample.origin, sample.seq, sample.relayed, sample.sent_ns)
