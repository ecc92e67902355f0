"""Where the files for services, containers and clusters stand."""

from __future__ import annotations

from pathlib import Path
from typing import Final

__all__ = ["DEPLOY", "ROOT"]

ROOT: Final = Path(__file__).parents[2]
DEPLOY: Final = ROOT / "deploy"
