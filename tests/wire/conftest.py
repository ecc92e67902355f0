from __future__ import annotations

import os
from collections.abc import Callable
from itertools import islice
from pathlib import Path

import pytest
from mcap.reader import make_reader

from ropeway.types import MessageCodec, TypeRegistry

Recorded = Callable[[str, int], list[bytes]]


@pytest.fixture(scope="session")
def registry() -> TypeRegistry:
    """All built-in types."""
    return TypeRegistry()


@pytest.fixture(scope="session")
def string(registry: TypeRegistry) -> MessageCodec:
    """How std_msgs/String is coded."""
    return registry.codec("std_msgs/msg/String")


@pytest.fixture(scope="session")
def recorded() -> Recorded:
    """The first messages of a topic of the recordings, as CDR."""
    data = os.environ.get("ROPEWAY_DATA") or Path(__file__).parents[2].parent / "shared" / "data"
    path = Path(data) / "dev.mcap"
    if not path.exists():
        pytest.skip("the recordings are not here; set ROPEWAY_DATA")

    def read(topic: str, count: int) -> list[bytes]:
        with path.open("rb") as file:
            return [message.data for _, _, message in islice(make_reader(file).iter_messages(topics=topic), count)]

    return read
