"""Logs on stderr: one sentence per line, with the time where nobody else adds it."""

from __future__ import annotations

import logging
import sys
from typing import Final

from ropeway.cli.console import fail
from ropeway.logs import LimitedHandler, line_format

__all__ = ["LEVELS", "set_up"]

LEVELS: Final = ("debug", "info", "warning", "error")


def set_up(level: str) -> str:
    """Send log lines of ``level`` and above to stderr; returns the level as ``logging`` spells it."""
    if level.lower() not in LEVELS:
        fail(f"{level!r} is not a log level; use one of {', '.join(LEVELS)}", 2)
    handler = LimitedHandler(sys.stderr)
    handler.setFormatter(line_format())
    logging.basicConfig(level=level.upper(), handlers=[handler], force=True)
    if level.lower() != "debug":
        logging.getLogger("asyncio").setLevel(logging.WARNING)
    return level.upper()
