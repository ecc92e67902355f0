"""ropeway.graph.topics_only: networks that know neither services nor actions."""

from __future__ import annotations

from collections.abc import Awaitable, Callable
from typing import Any

import pytest

from ropeway.errors import GraphUnavailable
from ropeway.graph.topics_only import TopicsOnlyGraph


class OnlyTopics(TopicsOnlyGraph):
    no_calls = "has topics only"


@pytest.mark.parametrize(
    "create",
    [
        lambda graph: graph.create_client("/s", "std_srvs/srv/Trigger"),
        lambda graph: graph.create_service("/s", "std_srvs/srv/Trigger", None),
        lambda graph: graph.create_action_client("/a", "example_interfaces/action/Fibonacci"),
        lambda graph: graph.create_action_server("/a", "example_interfaces/action/Fibonacci", None),
    ],
    ids=["client", "service", "action client", "action server"],
)
async def test_refused(create: Callable[[Any], Awaitable[object]]) -> None:
    """Services and actions are refused with the reason, and there are none."""
    graph = OnlyTopics("only")  # type: ignore[abstract]
    with pytest.raises(GraphUnavailable, match="has topics only"):
        await create(graph)
    assert (graph.services(), graph.actions()) == ({}, {})
