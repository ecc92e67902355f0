"""Says where a gateway keeps what outlives it."""

from __future__ import annotations

import hashlib
import os
from pathlib import Path

__all__ = ["default_journal", "state_directory"]


def default_journal(name: str, source: str) -> Path:
    """Return where the journal of a gateway is that runs a file: below ``XDG_STATE_HOME``, or ``~/.local/state``."""
    digest = hashlib.sha256(os.fsencode(Path(source).resolve())).hexdigest()[:12]
    return state_directory() / f"{name}-{digest}.journal"


def state_directory() -> Path:
    """Return where a gateway keeps what outlives it: the directory of its service, or one of its user."""
    return Path(os.environ.get("STATE_DIRECTORY", "").partition(":")[0] or _user_state())


def _user_state() -> Path:
    return Path(os.environ.get("XDG_STATE_HOME") or "~/.local/state").expanduser() / "ropeway"
