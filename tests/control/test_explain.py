"""A running gateway is asked why something does not cross."""

from __future__ import annotations

from typing import Any

from tests.control.conftest import Begin


async def explained(begin: Begin, **query: str) -> tuple[int, Any]:
    """Ask a gateway with one route, whose remote is not there."""
    route = {"name": "/odom", "type": "std_msgs/msg/String"}
    running = await begin([{"address": "ws://127.0.0.1:1", "publish": [route]}])
    answer = await running.client.get("/v1/explain", params=query)
    return answer.status_code, answer.json()


async def test_a_route(begin: Begin) -> None:
    """A route is explained with all that is in its way."""
    status, (found,) = await explained(begin, name="odom")
    assert status == 200
    assert found["path"] == "remotes[0].publish[0]"
    assert not found["crosses"]
    assert [finding["subject"] for finding in found["findings"] if finding["ok"] is False] == ["network", "link"]


async def test_a_name_without_a_route(begin: Begin) -> None:
    """A name that no route carries is told with the nearest."""
    _, (found,) = await explained(begin, name="/odmo")
    assert 'did you mean "/odom"?' in found["findings"][0]["text"]


async def test_a_bad_name(begin: Begin) -> None:
    """What is no name is refused with the reason."""
    status, answer = await explained(begin, name="a b")
    assert status == 422
    assert answer["error"].startswith("name: ")
