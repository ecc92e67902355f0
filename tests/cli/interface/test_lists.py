"""ropeway interface list, package, packages and proto: what is known, and what a message looks like."""

from __future__ import annotations

import json

import pytest

from tests.cli.conftest import Ropeway


def test_list(in_process: Ropeway) -> None:
    """Interfaces are listed by kind; options choose kinds."""
    everything = in_process("interface", "list").stdout
    assert [line for line in everything.splitlines() if not line.startswith(" ")] == [
        "Messages:",
        "Services:",
        "Actions:",
    ]
    services = json.loads(in_process("interface", "list", "-s", "--json").stdout)
    assert list(services) == ["srv"]
    assert "std_srvs/srv/SetBool" in services["srv"]


def test_packages(in_process: Ropeway) -> None:
    """Packages are listed, those with actions alone where asked; those of one package too."""
    assert "sensor_msgs" in in_process("interface", "packages").stdout.splitlines()
    assert "sensor_msgs" not in json.loads(in_process("interface", "packages", "-a", "--json").stdout)
    assert in_process("interface", "package", "std_srvs").stdout.splitlines() == [
        "std_srvs/srv/Empty",
        "std_srvs/srv/SetBool",
        "std_srvs/srv/Trigger",
    ]
    unknown = in_process("interface", "package", "nope")
    assert (unknown.returncode, "interface packages" in unknown.stderr) == (1, True)


@pytest.mark.parametrize(
    ("arguments", "printed"),
    [
        (["std_msgs/Header", "--no-quotes"], "stamp:\n  sec: 0\n  nanosec: 0\nframe_id: ''\n"),
        (["std_srvs/srv/SetBool"], '"data: false\n"\n'),
        (
            ["geometry_msgs/Quaternion", "--json"],
            '{"name":"geometry_msgs/msg/Quaternion","msg":{"x":0,"y":0,"z":0,"w":1}}\n',
        ),
    ],
)
def test_proto(in_process: Ropeway, arguments: list[str], printed: str) -> None:
    """A message is printed with the values that it has by itself, ready to be changed."""
    shown = in_process("interface", "proto", *arguments).stdout
    assert (json.loads(shown) == json.loads(printed)) if "--json" in arguments else (shown == printed)
