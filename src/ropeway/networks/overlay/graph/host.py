"""Defines what the parts of an ``overlay`` graph need of it."""

from __future__ import annotations

from typing import Protocol

from ropeway.graph.host import Host
from ropeway.networks.overlay.crypto.certificate import Certificate
from ropeway.networks.overlay.node import OverlayNode

__all__ = ["OverlayHost"]


class OverlayHost(Host, Protocol):
    """The graph, as all of its parts see it; each adds what it alone needs."""

    node: OverlayNode

    def allows(self, verb: str, name: str, certificate: Certificate) -> bool:
        """Return whether the owner of a certificate may read or call what is offered here."""
        ...
