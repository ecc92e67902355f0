"""Graphs: everything that has topics, services and actions, one module per kind of network."""

from __future__ import annotations

from ropeway.graph.factory import make_graph, open_graph

__all__ = ["make_graph", "open_graph"]
