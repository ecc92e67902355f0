"""Changes of state become events."""

from __future__ import annotations

from typing import Any

from ropeway.control.changes import ObjectState, StateChanges, states_of
from tests.control.conftest import Begin
from tests.support.until import until

LINK = ObjectState("link", "ws://cloud:9090", "connecting")


class Told:
    """Collects what is told."""

    def __init__(self) -> None:
        self.events: list[tuple[str, str, dict[str, Any]]] = []

    def __call__(self, kind: str, name: str, **data: Any) -> None:
        self.events.append((kind, name, data))


def test_each_change_once() -> None:
    """What is new, what has another state and what has gone are told once each."""
    told, states = Told(), [LINK]
    changes = StateChanges(lambda: states, told)
    changes.look()
    changes.look()
    states[:] = [LINK._replace(state="failed", why="refused")]
    changes.look()
    states.clear()
    changes.look()
    changes.look()
    assert [(data["before"], data["state"], data["why"]) for *_, data in told.events] == [
        ("", "connecting", ""),
        ("connecting", "failed", "refused"),
        ("failed", "gone", ""),
    ]


async def test_a_gateway(begin: Begin) -> None:
    """A gateway tells the states of its links and routes, without being asked."""
    running = await begin(
        [{"address": "ws://127.0.0.1:1", "publish": [{"name": "/odom", "type": "std_msgs/msg/String"}]}]
    )
    assert {(state.kind, state.name) for state in states_of(running.gateway)} == {
        ("link", "ws://127.0.0.1:1"),
        ("route", "publish /odom ws://127.0.0.1:1"),
    }
    await until(lambda: any(event.kind == "link" for event in running.manager.events.last()))
