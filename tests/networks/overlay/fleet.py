"""Fleets and members for tests."""

from __future__ import annotations

import itertools
import tempfile
from functools import cache
from pathlib import Path
from typing import Any

from ropeway.networks.overlay.crypto.identity import Identity
from ropeway.networks.overlay.fleet import Fleet

_numbers = itertools.count()


@cache
def fleet(name: str = "tests", algorithm: str = "ed25519") -> Fleet:
    """A fleet that all tests of a run share."""
    return Fleet.create(name, Path(tempfile.mkdtemp()) / name, algorithm=algorithm)


def member(name: str = "robot", of: Fleet | None = None, **options: Any) -> Identity:
    """A new member; a number makes its name its own."""
    return (of or fleet()).issue(f"{name}{next(_numbers)}", **options)
