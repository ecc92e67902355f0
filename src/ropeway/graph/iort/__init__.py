"""The ``iort`` graph: robots that speak text packets, as a network of topics."""

from __future__ import annotations
