"""Services of Fast DDS, which need the Cyclone DDS library of the wheel."""

from __future__ import annotations

import pytest


@pytest.fixture(autouse=True)
def library() -> None:
    """The library whose table of functions is known."""
    pytest.importorskip("cyclonedds", reason="services of Fast DDS need Cyclone DDS 11.0, that of the wheel")
