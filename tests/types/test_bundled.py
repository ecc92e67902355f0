"""The packages that are bundled."""

from __future__ import annotations

import subprocess
import sys

import pytest

from ropeway.types import TypeRegistry
from ropeway.types.bundled import FOLDER, Bundled, bundled_packages, has_changed
from ropeway.types.parser import PARTS
from ropeway.types.ros1_types import Ros1Types
from ropeway.types.stores import DISTROS
from ropeway.types.told_types import DefinitionTeller
from tests.types.packages import SOURCES

ROS2 = [distro for distro in DISTROS if distro != "noetic"]
NEEDED = (
    "nav2_msgs turtlesim moveit_msgs control_msgs ackermann_msgs vision_msgs geographic_msgs foxglove_msgs px4_msgs"
)


def test_every_source_has_a_file() -> None:
    """What the list of sources names is there, each with its source, licence and copyright."""
    assert bundled_packages() == {package for source in SOURCES for package in source.folders}
    assert bundled_packages() >= set(NEEDED.split())
    for source in SOURCES:
        for package in source.folders:
            head = (FOLDER / f"{package}.txt").read_text("utf-8").split("\n\n")[0]
            assert f"# Source: {source.repository} (" in head
            assert f"# Licence: {source.licence}\n" in head
            assert "# Copyright" in head


@pytest.fixture(scope="module")
def used() -> set[tuple[str, str | None]]:
    """Return the interfaces with all that they consist of, of any distribution, that were tried already."""
    return set()


@pytest.mark.parametrize("distro", ROS2)
def test_every_interface_can_be_used(distro: str, used: set[tuple[str, str | None]]) -> None:
    """Every bundled message, and every part of a service or action, is encoded and decoded in each distribution."""
    registry = TypeRegistry(distro, alone=True)
    for name in Bundled(distro):
        whole = name, registry.full_text(name)
        if whole not in used:
            used.add(whole)
            for end in PARTS[name.split("/")[1]]:
                codec = registry.codec(name + end)
                assert codec.encode(codec.decode(codec.encode({}))) == codec.encode({})
        if distro in ("jazzy", "kilted"):  # the hashes of those before Iron would need types that they lack
            assert registry.hash(name).startswith("RIHS01_")


def test_every_message_can_be_used_in_ros1() -> None:
    """Every bundled message and service of Noetic has its sum in ROS 1."""
    types = Ros1Types(TypeRegistry())
    for name in Bundled("noetic"):
        kind = name.split("/")[1]
        if kind == "msg":
            assert len(types.message(name).md5) == 32
        elif kind == "srv":
            assert len(types.service(name).md5) == 32


@pytest.mark.parametrize(
    ("name", "hash"),
    [
        ("turtlesim/msg/Pose", "863b248d5016ca62ea2e895ae5265cf9"),
        ("turtlesim/msg/Color", "353891e354491c51aabe32df673fb446"),
        ("octomap_msgs/msg/Octomap", "9a45536b45c5e409cd49f04bb2d9999f"),
    ],
)
def test_sums_of_ros1(name: str, hash: str) -> None:
    """The sum of a message is the one that ROS 1 gives it."""
    assert Ros1Types(TypeRegistry()).message(name).md5 == hash


def test_layouts_of_each_distribution() -> None:
    """Each distribution has its own layout, and what only some of them have is not known in the others."""
    humble, jazzy = (TypeRegistry(distro, alone=True) for distro in ("humble", "jazzy"))
    result = "nav2_msgs/action/NavigateToPose_Result"
    assert "error_code" not in humble.codec(result).fields
    assert "error_code" in jazzy.codec(result).fields
    assert humble.has("turtlesim/msg/Pose")
    assert not humble.has("turtlesim_msgs/msg/Pose")
    assert has_changed(result)
    assert not has_changed("turtlesim/msg/Pose")


def test_a_message_of_another_distribution_is_understood() -> None:
    """A goal's result of Humble's nav2 is read by a registry of another distribution, and the other way round."""
    registry = TypeRegistry("jazzy")
    others = registry.others
    assert others is not None
    humble = others.variant("humble")
    result = "nav2_msgs/action/NavigateToPose_Result"
    inward, outward = humble.inward(result), humble.outward(result)
    assert inward is not None
    assert outward is not None
    assert registry.codec(result).decode(inward(humble.codec(result).encode({})))["error_code"] == 0
    assert humble.codec(result).decode(outward(registry.codec(result).encode({"error_code": 7}))).keys() == {"result"}
    assert others.by_hash("nav2_msgs/action/NavigateToPose", humble.hash("nav2_msgs/action/NavigateToPose")) is humble


def test_files_of_the_user_go_first() -> None:
    """A definition that the user names takes the place of a bundled one."""
    registry = TypeRegistry()
    registry.add_text("px4_msgs/msg/ActuatorArmed", "bool of_mine\n", replace=True)
    assert list(registry.codec("px4_msgs/msg/ActuatorArmed").fields) == ["of_mine"]


def test_a_graph_knows_better() -> None:
    """What a graph tells of a bundled type is believed while the graph is there; what a client tells is not."""
    registry, name = TypeRegistry(), "px4_msgs/msg/ActuatorArmed"
    bundled = list(registry.codec(name).fields)
    client, graph = DefinitionTeller(registry), DefinitionTeller(registry, graph=True)
    client.tell(name, "bool of_a_client\n")
    assert list(registry.codec(name).fields) == bundled
    graph.tell(name, "uint64 timestamp\nbool of_the_robot\n")
    assert list(registry.codec(name).fields) == ["timestamp", "of_the_robot"]
    graph.leave()
    assert list(registry.codec(name).fields) == bundled


def test_a_recording_knows_better() -> None:
    """The definition in a recording takes the place of a bundled one, and not that of a file."""
    registry, name = TypeRegistry(), "px4_msgs/msg/ActuatorArmed"
    registry.add_unknown(name, "bool of_the_recording\n")
    assert list(registry.codec(name).fields) == ["of_the_recording"]
    registry.add_unknown(name, "bool of_another\n")
    assert list(registry.codec(name).fields) == ["of_the_recording"]


def test_a_package_is_read_when_it_is_needed() -> None:
    """A registry reads no package before somebody asks for a type of it, and then only that one."""
    code = (
        "from ropeway.types import TypeRegistry, bundled; r = TypeRegistry(); r.codec('sensor_msgs/msg/Image');"
        "r.has('my_msgs/msg/Foo'); before = bundled._package.cache_info().currsize; r.codec('turtlesim/msg/Pose');"
        "print(before, bundled._package.cache_info().currsize)"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.split() == ["0", "1"]


@pytest.mark.parametrize(
    ("name", "kind"),
    [("nav2_msgs/action/NavigateToPose", "action"), ("turtlesim/Spawn", "srv"), ("turtlesim/Pose", "msg")],
)
def test_types_of_the_papers(name: str, kind: str) -> None:
    """What the examples of the papers name is known without a workspace, to the parts of an action."""
    registry = TypeRegistry()
    assert registry.has(name, kind)
    for end in PARTS[kind]:
        assert registry.codec(registry.canonical(name, kind) + end).encode({})
