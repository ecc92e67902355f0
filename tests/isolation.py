"""Forwards to ``tests.support.isolation``, for tests that are being moved."""

from tests.support.isolation import isolated_dds

__all__ = ["isolated_dds"]
