"""The server of IoRT nodes: the paper's packets over TCP, and their upgrade."""

from __future__ import annotations

from ropeway.networks.iort.server.server import IortServer

__all__ = ["IortServer"]
