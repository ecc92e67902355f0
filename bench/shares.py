"""A share of a processor for a process: what a robot's small computer has, or a container on one.

``ROPEWAY_SHARE=0.25 make bench BENCH=loopback``, as root, gives each gateway a quarter of the first processor.
"""

from __future__ import annotations

import contextlib
import os
from pathlib import Path
from typing import Final

__all__ = ["Share", "asked"]

_GROUPS: Final = Path("/sys/fs/cgroup")
_PERIOD_US: Final = 100_000  # the kernel's own; whoever has used up its share waits for the next


def asked() -> float | None:
    """The share that ``ROPEWAY_SHARE`` asks for, if it is set."""
    text = os.environ.get("ROPEWAY_SHARE")
    return float(text) if text else None


class Share:
    """A control group for one process; ``remove`` it once the process has ended."""

    def __init__(self, pid: int, processors: float) -> None:
        quota_us = round(processors * _PERIOD_US)
        first = (_GROUPS / "cgroup.controllers").exists()  # version 2
        self._folder = (_GROUPS if first else _GROUPS / "cpu") / f"ropeway-bench-{pid}"
        self._folder.mkdir()
        if first:
            (self._folder / "cpu.max").write_text(f"{quota_us} {_PERIOD_US}")
        else:
            (self._folder / "cpu.cfs_period_us").write_text(str(_PERIOD_US))
            (self._folder / "cpu.cfs_quota_us").write_text(str(quota_us))
        (self._folder / "cgroup.procs").write_text(str(pid))
        os.sched_setaffinity(pid, {0})

    def remove(self) -> None:
        """Remove the group."""
        with contextlib.suppress(OSError):
            self._folder.rmdir()
