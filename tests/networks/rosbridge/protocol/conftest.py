from __future__ import annotations

import pytest

from ropeway.types import MessageCodec, TypeRegistry
from tests.support.fixtures import Recorded, recorded, registry

__all__ = ["Recorded", "recorded", "registry", "string"]


@pytest.fixture(scope="session")
def string(registry: TypeRegistry) -> MessageCodec:
    """How std_msgs/String is coded."""
    return registry.codec("std_msgs/msg/String")
