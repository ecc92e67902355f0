"""Recorded sensor data for the tests of types."""

from __future__ import annotations

import os
from pathlib import Path

import pytest


@pytest.fixture
def recordings() -> Path:
    """The directory of recorded sensor data; the test is skipped where there is none."""
    root = Path(os.environ.get("ROPEWAY_DATA", Path(__file__).parents[2].parent / "shared" / "data"))
    if not (root / "dev.mcap").exists():
        pytest.skip("no recorded sensor data; set ROPEWAY_DATA")
    return root
