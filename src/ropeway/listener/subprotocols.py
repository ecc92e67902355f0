"""The WebSocket subprotocols that are served."""

from __future__ import annotations

from typing import Final

__all__ = ["PLAIN_SUBPROTOCOL", "ROPEWAY_SUBPROTOCOL"]

ROPEWAY_SUBPROTOCOL: Final = "ropeway.1"
"""Names what Ropeway gateways speak with each other."""

PLAIN_SUBPROTOCOL: Final = "rosbridge"
"""A browser that sends its token as a subprotocol may offer this one, too, to be answered without the token."""
