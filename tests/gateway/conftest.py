"""Shares fixtures among the tests of gateways."""

from __future__ import annotations

from tests.support.world import world

__all__ = ["world"]
