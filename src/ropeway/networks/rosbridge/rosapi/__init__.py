"""rosapi, answered by the server itself: web clients ask it what there is, and no node of that name has to run."""

from __future__ import annotations

from ropeway.networks.rosbridge.rosapi.rosapi import SERVICES, Rosapi

__all__ = ["SERVICES", "Rosapi"]
