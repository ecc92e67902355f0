"""Types of a configuration that are not known."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from ropeway.gateway.config.config import load
from ropeway.gateway.config.type_hints import known_types, type_hints


def hints(tmp_path: Path, **operations: list[dict[str, str]]) -> list[tuple[str, str]]:
    """What is told of a configuration with one remote."""
    remote = {"address": "ws://127.0.0.1:1", **{key.replace("_", "-"): value for key, value in operations.items()}}
    file = tmp_path / "a.json"
    file.write_text(json.dumps({"gateway": {"name": "a", "listen": []}, "remotes": [remote]}))
    config = load(file)
    return type_hints(config, known_types(config))


@pytest.mark.parametrize(
    ("operation", "type", "meant"),
    [
        ("publish", "nav_msgs/msg/Odometri", "nav_msgs/msg/Odometry"),
        ("subscribe", "std_msgs/msg/Strin", "std_msgs/msg/String"),
        ("expose_service", "std_srvs/srv/Triger", "std_srvs/srv/Trigger"),
        ("reserve_action", "example_interfaces/action/Fibonaci", "example_interfaces/action/Fibonacci"),
    ],
)
def test_mistyped(tmp_path: Path, operation: str, type: str, meant: str) -> None:
    """A type that is nearly a known one of its kind is told with that one, once."""
    item = {"name": "/x", "type": type}
    ((path, hint),) = hints(tmp_path, **{operation: [item, {**item, "name": "/y"}]})
    assert path == f"remotes[0].{operation.replace('_', '-')}[0].type"
    assert hint == f'the type {type} is not known; did you mean "{meant}"?'


def test_known_and_foreign(tmp_path: Path) -> None:
    """Types that are known are not told of; one that resembles none is told to be unknown here."""
    assert hints(tmp_path, publish=[{"name": "/x", "type": "std_msgs/msg/String"}]) == []
    ((_, hint),) = hints(tmp_path, publish=[{"name": "/x", "type": "my_robot/msg/Whatever"}])
    assert "is not known here" in hint


def test_types_of_maps(tmp_path: Path) -> None:
    """Maps of nodes name types, too, of the gateway's listeners and of remotes."""
    maps = [{"system": "PEPPER", "topic": "cmd", "type": "geometry_msgs/Twistt"}]
    other = [{**maps[0], "type": "std_msgs/Strin"}]
    document = {
        "gateway": {"name": "a", "listen": [], "iort": {"maps": maps}},
        "remotes": [{"address": "iort://127.0.0.1:1", "maps": other}],
    }
    file = tmp_path / "a.json"
    file.write_text(json.dumps(document))
    config = load(file)
    assert type_hints(config, known_types(config)) == [
        (
            "gateway.iort.maps[0].type",
            'the type geometry_msgs/msg/Twistt is not known; did you mean "geometry_msgs/msg/Twist"?',
        ),
        ("remotes[0].maps[0].type", 'the type std_msgs/msg/Strin is not known; did you mean "std_msgs/msg/String"?'),
    ]


def test_types_that_one_network_defines(tmp_path: Path) -> None:
    """What the files of a network define alone is known."""
    file = tmp_path / "my_msgs" / "msg" / "Foo.msg"
    file.parent.mkdir(parents=True)
    file.write_text("int32 n\n")
    graph = {"address": "dds:0", "types": ["my_msgs"]}
    remote = {"address": "ws://127.0.0.1:1", "publish": [{"name": "/x", "type": "my_msgs/msg/Foo"}]}
    document = tmp_path / "a.json"
    document.write_text(json.dumps({"gateway": {"name": "a", "listen": [], "graphs": [graph]}, "remotes": [remote]}))
    config = load(document)
    assert type_hints(config, known_types(config)) == []
