"""Forwards to ``tests.support.threads``, for tests that are being moved."""

from tests.support.threads import new_threads

__all__ = ["new_threads"]
