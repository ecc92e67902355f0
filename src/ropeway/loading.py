"""Imports modules in a thread, so that an event loop that carries messages goes on meanwhile.

Most modules are imported before a loop runs. Those that few need are imported when somebody needs them, and that may
be while messages cross: seconds, where nobody has compiled them before.
"""

from __future__ import annotations

import asyncio
import contextlib
import gc
import importlib
import sys
from collections.abc import Iterable
from types import ModuleType

from ropeway.errors import RopewayError

__all__ = ["load", "preload"]


async def load(name: str) -> ModuleType:
    """Return a module, which is imported in a thread unless it is there already. Raises what the import raises.

    Where the garbage collector was told to leave alone what is there, it leaves alone what the module has brought.
    """
    there = sys.modules.get(name)
    if there is not None and not getattr(there.__spec__, "_initializing", False):
        return there
    module = await asyncio.to_thread(importlib.import_module, name)
    if gc.get_freeze_count():
        gc.freeze()
    return module


async def preload(names: Iterable[str]) -> None:
    """Import modules, so that importing them again takes no time; one that cannot be is left to whoever needs it."""
    for name in names:
        with contextlib.suppress(ImportError, OSError, RopewayError):
            await load(name)
