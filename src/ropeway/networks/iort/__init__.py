"""The ``iort`` graph: robots that speak text packets, as a network of topics."""

from __future__ import annotations

from ropeway.networks.iort.graph import IortGraph
from ropeway.networks.iort.links import LocalLink, RemoteLink
from ropeway.networks.iort.maps import Maps, TopicMap
from ropeway.networks.iort.space import Space

__all__ = ["IortGraph", "LocalLink", "Maps", "RemoteLink", "Space", "TopicMap"]
