"""Ropeway joins robots and clouds that live on different networks.

Everything that has topics, services and actions is a ``Graph``; a bridge joins one name on two graphs.
"""

from __future__ import annotations

__all__ = ["__version__"]

__version__ = "0.1.0"
