"""One document describes many gateways, each of which can be run, and which are checked across."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import pytest

from ropeway.errors import ConfigError
from ropeway.gateway.config.config import parse
from ropeway.gateway.config.fleet import GatewayFleet, load_one, read_fleet, select

TWIST = "geometry_msgs/msg/Twist"
ODOM = "nav_msgs/msg/Odometry"


def _gateway(*listen: str, **more: Any) -> dict[str, Any]:
    return {"graphs": ["memory:a"], "listen": list(listen), "insecure": True, **more}


def _document() -> dict[str, Any]:
    return {
        "gateways": {
            "cloud": {"host": "cloud.example", "gateway": _gateway("ws://0.0.0.0:9090")},
            "robot": {
                "host": "robot.local",
                "gateway": _gateway(),
                "remotes": [{"address": "ws://cloud.example:9090", "publish": [{"name": "/odom", "type": ODOM}]}],
            },
        }
    }


def _faults(document: Any) -> list[tuple[str, str]]:
    with pytest.raises(ConfigError) as caught:
        read_fleet(document)
    return list(caught.value.problems)


def test_each_is_a_configuration(tmp_path: Path) -> None:
    """Every gateway is read by its name, which it has unless it says another."""
    file = tmp_path / "fleet.json"
    file.write_text(json.dumps(_document()))
    robot = load_one(file, "robot")
    assert (robot.gateway.name, robot.part, robot.source, len(robot.routes())) == ("robot", "robot", str(file), 1)
    fleet = read_fleet(_document())
    assert list(fleet.members) == ["cloud", "robot"]
    assert fleet.findings() == []
    assert fleet.members["robot"].etag == robot.etag


@pytest.mark.parametrize(
    ("name", "said"),
    [("", "choose with --as: cloud, robot"), ("robt", "robot")],
)
def test_one_has_to_be_chosen(name: str, said: str) -> None:
    """Without a name, or with one that is not there, the names are told."""
    with pytest.raises(ConfigError, match=said):
        select(_document(), name)


def test_a_name_is_for_many_only() -> None:
    """A document for one gateway has no names to choose from, and is read as ever."""
    assert select({"remotes": []}, "") == {"remotes": []}
    with pytest.raises(ConfigError, match="leave --as robot out"):
        select({"remotes": []}, "robot")


def test_a_library_says_what_to_do() -> None:
    """A document for many is no configuration of one, and the error says how to choose."""
    with pytest.raises(ConfigError, match="choose one of them with --as"):
        parse(_document())


def test_faults_of_all_are_told() -> None:
    """Faults have the name of their gateway in their path, those of all gateways at once."""
    document = _document()
    document["gateways"]["cloud"]["gateway"]["nme"] = "x"
    document["gateways"]["robot"]["remotes"][0]["publish"][0]["tpe"] = "y"
    document["gateways"]["robot"]["host"] = 5
    assert sorted(path for path, _ in _faults(document)) == [
        "gateways.cloud.gateway.nme",
        "gateways.robot.host",
        "gateways.robot.remotes[0].publish[0].tpe",
    ]


@pytest.mark.parametrize("members", [{}, [], {"robot": []}, None])
def test_the_shape_is_checked(members: Any) -> None:
    """Whatever stands in the place of gateways that is none is refused."""
    assert _faults({"gateways": members})


def test_an_unknown_key_is_refused() -> None:
    """A key beside gateways is refused."""
    assert _faults({**_document(), "remotes": []})[0][0] == "remotes"


def test_two_of_one_name_clash() -> None:
    """Two gateways that call themselves the same are a fault."""
    document = _document()
    document["gateways"]["robot"]["gateway"]["name"] = "cloud"
    assert _faults(document)[0][0] == "gateways.robot.gateway.name"


@pytest.mark.parametrize(
    ("first", "second", "clash"),
    [
        ("ws://0.0.0.0:9090", "ws://127.0.0.1:9090", True),
        ("ws://127.0.0.1:9090", "ws://127.0.0.1:9090", True),
        ("ws://10.0.0.1:9090", "ws://10.0.0.2:9090", False),
        ("ws://0.0.0.0:9090", "ws://0.0.0.0:9091", False),
        ("ws://0.0.0.0:0", "ws://0.0.0.0:0", False),
    ],
)
def test_ports_of_one_host_clash(first: str, second: str, clash: bool) -> None:
    """A port that two gateways of one host listen at is a fault; on two hosts it is none."""
    document = {
        "gateways": {
            "a": {"host": "one", "gateway": _gateway(first)},
            "b": {"host": "one", "gateway": _gateway(second)},
        }
    }
    if clash:
        assert [path for path, _ in _faults(document)] == ["gateways.b.gateway.listen[0]"]
    else:
        read_fleet(document)
    document["gateways"]["b"]["host"] = "two"
    read_fleet(document)


@pytest.mark.parametrize(
    ("address", "listen", "said"),
    [
        ("ws://cloud.example:9091", "ws://0.0.0.0:9090", "nobody listens at ws://cloud.example:9091"),
        ("ws://cloud.example:9090", "ws://127.0.0.1:9090", "only its own machine reaches"),
        ("wss://cloud.example:9090", "ws://0.0.0.0:9090", "write ws:// here"),
        ("ws://robot.local:9090", "ws://0.0.0.0:9090", None),
        ("ws://elsewhere:9090", "ws://0.0.0.0:9090", None),
    ],
)
def test_who_is_dialled_listens(address: str, listen: str, said: str | None) -> None:
    """A gateway that is dialled listens there, reachable and in the same way; others are not judged."""
    document = _document()
    document["gateways"]["cloud"]["gateway"]["listen"] = [listen]
    document["gateways"]["robot"]["remotes"][0]["address"] = address
    if said is None:
        read_fleet(document)
        return
    [(path, text)] = _faults(document)
    assert path == "gateways.robot.remotes[0].address"
    assert said in text


def _overlay(*items: dict[str, Any]) -> dict[str, Any]:
    remote: dict[str, Any] = {"address": "overlay"}
    for item in items:
        operation = item.pop("operation")
        remote.setdefault(operation, []).append(item)
    return remote


def test_what_is_read_is_sent(tmp_path: Path) -> None:
    """What a gateway fetches from the overlay is sent by another, with the same type; else that is said."""
    identity = tmp_path / "id.json"
    identity.write_text("{}")
    gateway = _gateway(overlay={"identity": str(identity)})
    fetched = [
        {"operation": "subscribe", "name": "/cmd", "type": TWIST},
        {"operation": "subscribe", "name": "/odom", "type": TWIST},
        {"operation": "subscribe", "name": "/lonely", "type": TWIST},
    ]
    sent = [
        {"operation": "publish", "name": "/cmd", "type": TWIST},
        {"operation": "publish", "name": "/odom", "type": ODOM},
    ]
    members = {
        "a": {"gateway": gateway, "remotes": [_overlay(*fetched)]},
        "b": {"gateway": gateway, "remotes": [_overlay(*sent)]},
    }
    configs = {name: parse(select({"gateways": members}, name), part=name) for name in members}
    findings = GatewayFleet(configs, {}).findings()
    assert [(found.path, found.fault) for found in findings] == [
        ("gateways.a.remotes[0].subscribe[1]", True),
        ("gateways.a.remotes[0].subscribe[2]", False),
    ]
    assert "b has /odom with the type nav_msgs/msg/Odometry" in findings[0].text
