"""Kinds of network, one folder each: everything that has topics, services and actions becomes a ``Graph``."""

from __future__ import annotations

from ropeway.networks.factory import make_graph, open_graph

__all__ = ["make_graph", "open_graph"]
