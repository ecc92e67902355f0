"""The server role: rosbridge clients and other gateways connect here and use a graph through it."""

from __future__ import annotations

from ropeway.server.server import RosbridgeServer
from ropeway.server.session import Session

__all__ = ["RosbridgeServer", "Session"]
