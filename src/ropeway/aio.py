"""Supplies the parts of newer asyncio that Python 3.10 lacks; no other module asks which Python it runs on.

Use these names instead of those of ``asyncio``: ``aio.timeout``, ``aio.TaskGroup``, ``aio.Runner``. From Python 3.11 on
they are those of the standard library; for 3.10 they come from ``ropeway.aio310``.
"""

from __future__ import annotations

import asyncio
import sys
from typing import Any

if sys.version_info >= (3, 11):
    from asyncio import Runner, TaskGroup, timeout, timeout_at
    from builtins import BaseExceptionGroup, ExceptionGroup

    def cancelling(task: asyncio.Task[Any]) -> int:
        """Return how many cancellations of the task were asked for and not taken back."""
        return task.cancelling()

    def uncancel(task: asyncio.Task[Any]) -> int:
        """Take back one request to cancel the task, and return how many are left."""
        return task.uncancel()
else:
    from exceptiongroup import BaseExceptionGroup, ExceptionGroup

    from ropeway.aio310 import Runner, TaskGroup, cancelling, timeout, timeout_at, uncancel

__all__ = [
    "BaseExceptionGroup",
    "ExceptionGroup",
    "Runner",
    "TaskGroup",
    "cancelling",
    "timeout",
    "timeout_at",
    "uncancel",
]
