"""Forwards to ``tests.support.ports``, for tests that are being moved."""

from tests.support.ports import free_port

__all__ = ["free_port"]
