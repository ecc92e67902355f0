from __future__ import annotations

from tests.support.place import bare, place

__all__ = ["bare", "place"]
