"""Graphs to open by URL: of a network in the process, of a DDS domain, and behind a rosbridge server."""

from __future__ import annotations

import itertools
from collections.abc import AsyncIterator, Iterator

import pytest

import ropeway
from tests.support.isolation import isolated_dds

_numbers = itertools.count()


@pytest.fixture(scope="session", autouse=True)
def dds_isolation() -> Iterator[None]:
    """Participants of this test run discover each other only."""
    with isolated_dds():
        yield


def new_network() -> str:
    """Return the URL of a network of this process that nobody uses yet."""
    return f"memory:api-{next(_numbers)}"


@pytest.fixture
def network() -> str:
    """Such a URL."""
    return new_network()


@pytest.fixture(params=["memory", "dds", "ws"])
async def url(request: pytest.FixtureRequest) -> AsyncIterator[str]:
    """The URL of a graph, for three kinds of graphs."""
    if request.param == "memory":
        yield new_network()
    elif request.param == "dds":
        yield "dds:58?interface=lo"
    else:
        config = {"gateway": {"graphs": [new_network()], "listen": ["ws://127.0.0.1:0"]}}
        async with ropeway.open_gateway(config) as gateway:
            yield f"ws://127.0.0.1:{gateway.ports[0]}"
