"""The ``iort`` graph: robots that speak text packets, as a network of topics."""

from __future__ import annotations

from ropeway.graph.iort.graph import IortGraph
from ropeway.graph.iort.links import LocalLink, RemoteLink
from ropeway.graph.iort.maps import Maps, TopicMap
from ropeway.graph.iort.space import Space

__all__ = ["IortGraph", "LocalLink", "Maps", "RemoteLink", "Space", "TopicMap"]
