"""The server role: rosbridge clients and other gateways connect here and use a graph through it."""

from __future__ import annotations

from ropeway.networks.rosbridge.server.server import RosbridgeServer
from ropeway.networks.rosbridge.server.session import Session

__all__ = ["RosbridgeServer", "Session"]
