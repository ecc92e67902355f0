"""ropeway interface show: a definition, with what its fields consist of."""

from __future__ import annotations

import json
from pathlib import Path

from ropeway.cli.interface.show import definition_lines
from ropeway.types import TypeRegistry
from tests.cli.conftest import Ropeway


def test_nested_types(in_process: Ropeway) -> None:
    """Below each field stand those of its type, deeper by a tab."""
    told = in_process("interface", "show", "std_msgs/Header")
    assert told.stdout == "builtin_interfaces/Time stamp\n\tint32 sec\n\tuint32 nanosec\nstring frame_id\n"


def test_services_and_actions(in_process: Ropeway) -> None:
    """A service has two parts, an action three; a name without kind finds them."""
    assert (
        in_process("interface", "show", "std_srvs/SetBool").stdout == "bool data\n---\nbool success\nstring message\n"
    )
    action = in_process("interface", "show", "nav2_msgs/action/Spin").stdout
    assert action.count("---\n") == 2
    assert "\tint32 sec\n" in action


def test_comments() -> None:
    """The comments of a definition are kept, those of nested types and all others only where asked for."""
    registry = TypeRegistry()
    registry.add_text("a/msg/Inner", "# inner\nstring TEXT='# none'  # constant\nint8 x\n")
    registry.add_text("a/msg/Outer", "# outer\n\nInner[2] inner  # two of them\nstring[<=3] names\n")
    kept = ["# outer", "", "Inner[2] inner  # two of them", "\tstring TEXT='# none'", "\tint8 x", "string[<=3] names"]
    assert list(definition_lines(registry, "a/msg/Outer")) == kept
    bare = ["Inner[2] inner", "\tstring TEXT='# none'", "\tint8 x", "string[<=3] names"]
    assert list(definition_lines(registry, "a/msg/Outer", comments=False)) == bare
    every = list(definition_lines(registry, "a/msg/Outer", all_comments=True))
    assert every[3:5] == ["\t# inner", "\tstring TEXT='# none'  # constant"]


def test_as_json(in_process: Ropeway, tmp_path: Path) -> None:
    """``--json`` gives name, hash, text and dependencies, also of a definition in a file."""
    (tmp_path / "Own.msg").write_text("geometry_msgs/Point where\n")
    told = json.loads(
        in_process("interface", "show", "own_msgs/Own", "--json", "--types", str(_package(tmp_path))).stdout
    )
    assert (told["name"], told["text"]) == ("own_msgs/msg/Own", "geometry_msgs/Point where\n")
    assert told["hash"].startswith("RIHS01_")
    assert told["dependencies"] == ["geometry_msgs/msg/Point"]


def _package(directory: Path) -> Path:
    """Make a package of the definitions in a directory."""
    messages = directory / "own_msgs" / "msg"
    messages.mkdir(parents=True)
    (directory / "Own.msg").rename(messages / "Own.msg")
    return directory


def test_what_nobody_knows(in_process: Ropeway) -> None:
    """A name that is none, or that nobody knows, ends with what is near, or with what to do."""
    near = in_process("interface", "show", "sensor_msg/msg/Image")
    assert near.returncode == 1
    assert "did you mean sensor_msgs/msg/Image?" in near.stderr
    assert "--types" in in_process("interface", "show", "nope/msg/X").stderr
    assert in_process("interface", "show", "bad").returncode == 2
