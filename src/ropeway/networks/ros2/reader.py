"""A subscription of rclpy, emptied without rclpy."""

from __future__ import annotations

import time
import weakref
from collections.abc import Callable
from typing import Any, Final

from ropeway.graph.base import Sample
from ropeway.networks.ros2.origins import Origins
from ropeway.networks.ros2.rcl import Rcl, RclError
from ropeway.networks.ros2.spinner import Spinner

__all__ = ["SpinnerReader"]

_BURST: Final = 256
_BURST_BYTES: Final = 8 << 20
_LITTLE: Final = b"\1"

_Taken = tuple[bytes, int, bytes, int]  # payload, source time stamp, gid, time of arrival


class SpinnerReader:
    """Takes what arrives in the spinner's thread, and gives samples to ``deliver`` on the loop.

    ``turned`` makes little-endian what is not, or ``None`` of what it cannot read.
    """

    def __init__(
        self,
        raw: Any,
        topic: str,
        type: str,
        spinner: Spinner,
        rcl: Rcl,
        origins: Origins,
        turned: Callable[[str, str, bytes], bytes | None],
    ) -> None:
        self.raw = raw
        self.closed = False
        self.deliver: Callable[[list[Sample]], None] = _nobody
        self._topic, self._type = topic, type
        self._spinner, self._rcl, self._origins = spinner, rcl, origins
        self._turned = turned
        self._buffer = rcl.buffer()
        weakref.finalize(self, rcl.free, self._buffer)  # once the thread has let go of us, too

    @property
    def matched(self) -> int:
        """The number of matched publishers, ours included."""
        if self.closed:
            return 0
        with self.raw.handle:
            return self._rcl.publisher_count(self.raw.handle.pointer)

    def take(self) -> None:
        """Take what is there, in the thread; the spinner holds the handle."""
        take, pointer, buffer = self._rcl.take, self.raw.handle.pointer, self._buffer
        batch: list[_Taken] = []
        size = 0
        while len(batch) < _BURST and size < _BURST_BYTES:
            taken = take(pointer, buffer)
            if taken is None:
                break
            batch.append((*taken, time.time_ns()))
            size += len(taken[0])
        if batch:
            self._spinner.push(self.on_taken, batch, len(batch), size)

    def on_taken(self, batch: list[_Taken]) -> None:
        """Make samples of a batch, on the loop."""
        if self.closed:
            return
        samples = []
        for payload, source_ns, gid, stamp_ns in batch:
            found = self._origins.of(self._topic, self._type, gid, self._count)
            if found is None:
                continue
            origin, unsure = found
            native = payload if payload[1:2] == _LITTLE else self._turned(self._topic, self._type, payload)
            if native is not None:
                samples.append(Sample(native, self._type, stamp_ns, origin, source_ns or stamp_ns, unsure))
        if samples:
            self.deliver(samples)

    def _count(self) -> int:
        try:
            return self.matched
        except RclError:
            return -1


def _nobody(_: list[Sample]) -> None:
    """Ignore samples: nobody reads yet."""
