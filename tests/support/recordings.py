"""Where the recorded sensor data is."""

from __future__ import annotations

import os
from pathlib import Path
from typing import Final

import pytest

__all__ = ["RECORDINGS", "recording"]

RECORDINGS: Final = Path(os.environ.get("ROPEWAY_DATA") or Path(__file__).parents[3] / "shared" / "data")


def recording(name: str = "dev.mcap") -> Path:
    """Return the path of a recording, or skip the test where it is not there."""
    path = RECORDINGS / name
    if not path.exists():
        pytest.skip("needs recorded sensor data: name its directory in ROPEWAY_DATA")
    return path
