"""Defines what the doctor finds."""

from __future__ import annotations

from dataclasses import asdict, dataclass
from typing import Any

__all__ = ["Symptom"]


@dataclass(frozen=True, slots=True)
class Symptom:
    """A finding. ``ok`` is ``False`` for what keeps Ropeway from working, ``None`` for what may be better."""

    ok: bool | None
    about: str
    text: str
    remedy: str = ""

    def to_json(self) -> dict[str, Any]:
        """Return the finding as JSON."""
        return asdict(self)
