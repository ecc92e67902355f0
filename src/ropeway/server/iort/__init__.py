"""The server of IoRT nodes: the paper's packets over TCP, and their upgrade."""

from __future__ import annotations

from ropeway.server.iort.server import IortServer

__all__ = ["IortServer"]
