"""Runs the blocking work of a backend in a thread of its own."""

from __future__ import annotations

import asyncio
import logging
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from typing import Any, TypeVar

from ropeway.errors import StoreError, StoreUnavailable
from ropeway.tasks import describe

__all__ = ["run_in"]

log = logging.getLogger("ropeway.store")

T = TypeVar("T")


async def run_in(thread: ThreadPoolExecutor, url: str, work: Callable[..., T], *args: Any) -> T:
    """Run the work of the backend at ``url``. Raises ``StoreError``, whatever the backend raised."""
    try:
        return await asyncio.get_running_loop().run_in_executor(thread, work, *args)
    except StoreError:
        raise
    except Exception as error:  # of a database or a file system: what is kept is still here
        log.debug("%s", url, exc_info=error)
        raise StoreUnavailable(url, describe(error)) from error
