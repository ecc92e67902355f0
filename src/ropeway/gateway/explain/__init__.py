"""Explains why something crosses or does not: the chain from publisher to reader, link by link, on both ends.

What decides is what explains: the findings ask graphs, bridges and links for the state on which these act.
"""

from __future__ import annotations

from ropeway.gateway.explain.explanation import Explanation, Finding, Subject
from ropeway.gateway.explain.routes import explain, reason_of
from ropeway.gateway.explain.watch import RouteWatch

__all__ = ["Explanation", "Finding", "RouteWatch", "Subject", "explain", "reason_of"]
