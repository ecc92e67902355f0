"""Supplies the parts of newer asyncio that Python 3.10 lacks; no other module asks which Python it runs on.

Use these names instead of those of ``asyncio``: ``aio.timeout``, ``aio.TaskGroup``, ``aio.Runner``. From Python 3.11 on
they are those of the standard library; for 3.10 they come from ``ropeway.aio310``.
"""

from __future__ import annotations

import asyncio
import sys
from collections.abc import Callable
from typing import Any

if sys.version_info >= (3, 11):
    from asyncio import Runner, TaskGroup, timeout, timeout_at
    from builtins import BaseExceptionGroup, ExceptionGroup

    cancelling: Callable[[asyncio.Task[Any]], int] = asyncio.Task.cancelling
    uncancel: Callable[[asyncio.Task[Any]], int] = asyncio.Task.uncancel
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
