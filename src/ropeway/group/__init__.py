"""Groups: several graphs that offer the same names count as one, and a policy says which of them answers."""

from __future__ import annotations

from ropeway.group.bound import LatencyBound
from ropeway.group.graph import Group, Policy

__all__ = ["Group", "LatencyBound", "Policy"]
