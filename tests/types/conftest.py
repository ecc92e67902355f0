"""Recorded sensor data for the tests of types."""

from __future__ import annotations

from pathlib import Path

import pytest

from tests.support.recordings import recording


@pytest.fixture
def recordings() -> Path:
    """The directory of recorded sensor data; the test is skipped where there is none."""
    return recording().parent
