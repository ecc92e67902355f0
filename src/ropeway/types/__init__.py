"""Provides message definitions and codecs without a ROS installation."""

from ropeway.types.codec import MessageCodec
from ropeway.types.registry import TypeRegistry

__all__ = ["MessageCodec", "TypeRegistry"]


def _make_variant(ours: TypeRegistry, distro: str) -> TypeRegistry:
    from ropeway.types.variant import Variant  # which few need

    return Variant(ours, distro)


TypeRegistry.make_variant = staticmethod(_make_variant)
