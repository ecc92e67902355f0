"""A fleet with a member, made anew in each process."""

from __future__ import annotations

from pathlib import Path
from tempfile import TemporaryDirectory

from ropeway.networks.overlay.crypto.identity import Identity
from ropeway.networks.overlay.fleet import Fleet

__all__ = ["FLEET", "MEMBER"]


def _make() -> tuple[Fleet, Identity]:
    with TemporaryDirectory(prefix="fuzz-") as folder:
        fleet = Fleet.create("fuzz", Path(folder) / "fuzz")
        return fleet, fleet.issue("member")


FLEET, MEMBER = _make()
