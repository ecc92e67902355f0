from __future__ import annotations

from collections.abc import Callable
from itertools import islice

import pytest
from mcap.reader import make_reader

from ropeway.types import MessageCodec, TypeRegistry
from tests.support.recordings import recording

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
    path = recording()

    def read(topic: str, count: int) -> list[bytes]:
        with path.open("rb") as file:
            return [message.data for _, _, message in islice(make_reader(file).iter_messages(topics=topic), count)]

    return read
