"""Fixtures that several folders of tests share; their ``conftest.py`` imports them."""

from __future__ import annotations

from collections.abc import Callable
from itertools import islice

import pytest
from mcap.reader import make_reader

from ropeway.types import TypeRegistry
from tests.support.recordings import recording

__all__ = ["Recorded", "recorded", "registry"]

Recorded = Callable[[str, int], list[bytes]]


@pytest.fixture(scope="session")
def registry() -> TypeRegistry:
    """All built-in types."""
    return TypeRegistry()


@pytest.fixture(scope="session")
def recorded() -> Recorded:
    """The first messages of a topic of the recordings, as CDR."""
    path = recording()

    def read(topic: str, count: int) -> list[bytes]:
        with path.open("rb") as file:
            return [message.data for _, _, message in islice(make_reader(file).iter_messages(topics=topic), count)]

    return read
