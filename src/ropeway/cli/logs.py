"""Logs on stderr: one sentence per line, with the time where nobody else adds it."""

from __future__ import annotations

import logging
import os
import sys
from typing import Final

from ropeway.cli.console import fail
from ropeway.logs import LimitedHandler

__all__ = ["LEVELS", "set_up"]

LEVELS: Final = ("debug", "info", "warning", "error")


def set_up(level: str) -> str:
    """Send log lines of ``level`` and above to stderr; returns the level as ``logging`` spells it."""
    if level.lower() not in LEVELS:
        fail(f"{level!r} is no log level; use one of {', '.join(LEVELS)}", 2)
    under_systemd = "JOURNAL_STREAM" in os.environ  # the journal has its own clock
    text = "%(levelname)-7s %(message)s" if under_systemd else "%(asctime)s.%(msecs)03d %(levelname)-7s %(message)s"
    handler = LimitedHandler(sys.stderr)
    handler.setFormatter(logging.Formatter(text, "%H:%M:%S"))
    logging.basicConfig(level=level.upper(), handlers=[handler], force=True)
    if level.lower() != "debug":
        logging.getLogger("asyncio").setLevel(logging.WARNING)
    return level.upper()
