from __future__ import annotations

from tests.support.fixtures import Recorded, recorded, registry

__all__ = ["Recorded", "recorded", "registry"]
