"""Forwards to ``tests.support.until``, for tests that are being moved."""

from tests.support.until import until

__all__ = ["until"]
