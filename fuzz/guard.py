"""Runs one input of a target and says what is wrong with what happened."""

from __future__ import annotations

import ctypes
import gc
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Final

from fuzz.target import Target

__all__ = ["Fault", "Guard"]

_PEAK: Final = Path("/proc/self/clear_refs")
_STATUS: Final = Path("/proc/self/status")
_RESET_PEAK: Final = "5"
_MMAP_THRESHOLD: Final = -3  # of mallopt
_OWN_MAPPING_BYTES: Final = 128 << 10  # a block above it is given back to the system as soon as it is free
_TRIES: Final = 3  # the first of which also pays for what is imported and generated once


class Fault(Exception):
    """An input that costs more than it may."""


class Guard:
    """Judges inputs of one target.

    Memory is what the process holds at most while the input is read, so that what C libraries allocate counts, too.
    """

    def __init__(self, target: Target) -> None:
        self.target = target
        self._libc = ctypes.CDLL(None)
        self._libc.mallopt(_MMAP_THRESHOLD, _OWN_MAPPING_BYTES)

    def check(self, data: bytes) -> None:
        """Run ``data``. Raises ``Fault`` if it costs too much, and whatever the parser should not have raised."""
        for left in reversed(range(_TRIES)):
            cost = self._run(data)
            if not cost:
                return
            if not left:
                raise Fault(f"{len(data)} bytes of input cost {cost}")
            gc.collect()
            self._libc.malloc_trim(0)

    def _run(self, data: bytes) -> str:
        """What was too much, ``""`` if nothing was."""
        target = self.target
        _PEAK.write_text(_RESET_PEAK)
        before = _resident_bytes("VmRSS")
        began = time.thread_time()
        with _own(target.errors):
            target.run(data)
        spent_s = time.thread_time() - began
        held = _resident_bytes("VmHWM") - before
        if held > target.memory_bytes + target.memory_per_byte * len(data):
            return f"{held / (1 << 20):.0f} MiB of memory"
        return f"{spent_s:.2f} s of CPU time" if spent_s > target.cpu_s else ""


@contextmanager
def _own(errors: tuple[type[Exception], ...]) -> Iterator[None]:
    """Let the parser's own errors pass; what they say must be printable without a failure of its own."""
    try:
        yield
    except errors as error:
        str(error)


def _resident_bytes(key: str) -> int:
    text = _STATUS.read_text()
    return int(text[text.index(key) + len(key) + 1 :].split(None, 1)[0]) << 10
