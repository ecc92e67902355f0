"""ropeway.gateway.config.group_hints: pairs of topics that tell no latency."""

from __future__ import annotations

from typing import Any

import pytest

from ropeway.gateway.config import config
from ropeway.gateway.config.group_hints import group_hints
from tests.gateway.config.test_policy import group, listing


def hints(anycast: dict[str, Any]) -> dict[str, str]:
    """Return what is told of a group with this policy, by path."""
    return dict(group_hints(config.parse([group(anycast)])))


def states(service: list[dict[str, str]]) -> dict[str, Any]:
    """Return the listing's policy with these topics of the service."""
    made = listing()
    made["state_definition"]["service"] = {"topics": service}
    return made


@pytest.mark.parametrize(
    ("anycast", "path", "words"),
    [
        ({"responses": {"/yolo/inptu": "/yolo/output"}}, "responses", 'not in "publish"'),
        ({"responses": {"/yolo/input": "/yolo/outputt"}}, "responses", 'did you mean "/yolo/output"?'),
        (
            states([{"/yolo/input": "sub"}, {"/yolo/outputt": "pub"}]),
            "state_definition.service.topics",
            'did you mean "/yolo/output"?',
        ),
        (states([{"/yolo/input": "pub"}]), "state_definition.service.topics", 'not "sub" in state robot'),
    ],
)
def test_topics_without_another_end(anycast: dict[str, Any], path: str, words: str) -> None:
    """A topic that nobody asks or answers on the other side is told with its path and the nearest that fits."""
    assert words in hints(anycast)[f"remotes[0].anycast.{path}"]


@pytest.mark.parametrize("anycast", [{}, listing(), {"responses": {"yolo/input": "/yolo/output"}}])
def test_nothing_to_tell(anycast: dict[str, Any]) -> None:
    """Nothing is told of topics that are asked and answered, and of a group without them."""
    assert hints(anycast) == {}
