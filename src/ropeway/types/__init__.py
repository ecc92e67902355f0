"""Provides message definitions and codecs without a ROS installation."""

from ropeway.types.codec import MessageCodec
from ropeway.types.registry import TypeRegistry

__all__ = ["MessageCodec", "TypeRegistry"]
