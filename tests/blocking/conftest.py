"""Networks for threads."""

from __future__ import annotations

import itertools
from collections.abc import Iterator

import pytest

from ropeway.blocking.portal import portal
from tests.support.isolation import isolated_dds
from tests.support.threads import new_threads

_numbers = itertools.count()


@pytest.fixture(scope="session", autouse=True)
def dds_isolation() -> Iterator[None]:
    """Participants of this test run discover each other only."""
    with isolated_dds():
        yield


@pytest.fixture(autouse=True)
def nothing_stays() -> Iterator[None]:
    """The thread of the event loop has ended after each test."""
    started = new_threads()
    yield
    portal.close_all()
    assert "ropeway.blocking" not in started()


@pytest.fixture
def network() -> str:
    """The URL of a network of this process that nobody uses yet."""
    return f"memory:blocking-{next(_numbers)}"
