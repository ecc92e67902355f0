"""Writes ``src/ropeway/types/packages/*.txt`` from clones of the sources: ``python -m tests.types.packages CLONES``.

``CLONES`` has a git repository for each source below it, bare or not, in ``<name>``, ``<name>.git`` or
``<owner>+<name>/repo``, with the branches that ``SOURCES`` names.
"""

from __future__ import annotations

import re
import subprocess
import sys
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Final

import ropeway.types.bundled as bundled
from ropeway.types.definition import Definition
from ropeway.types.parser import PARTS, parse_interface
from ropeway.types.stores import DISTROS

__all__ = ["SOURCES", "Source", "written"]

_FILE: Final = re.compile(r"(?:.*/)?(?P<name>[A-Za-z0-9_]+)\.(?P<kind>msg|srv|action)\Z")
_COPYRIGHT: Final = re.compile(r"^[ \t*#]*(Copyright (?:\(c\)|©|\d).*\S)", re.IGNORECASE | re.MULTILINE)


def _span(noetic: str = "", **refs: str) -> dict[str, str]:
    """Return the branch of every distribution: each one's that is not named is that of the one before it."""
    found = {"noetic": noetic} if noetic else {}
    last = ""
    for distro in DISTROS[1:]:
        last = refs.get(distro, last)
        if last:
            found[distro] = last
    return found


@dataclass(frozen=True)
class Source:
    """Where packages come from: ``folders`` by package, ``refs`` by distribution; ``ros1`` is a folder of its own."""

    repository: str
    licence: str
    folders: Mapping[str, str]
    refs: Mapping[str, str]
    ros1: str = ""
    only: Mapping[str, str] = field(default_factory=dict)  # packages that begin with a later distribution


_EACH: Final = {distro: distro for distro in DISTROS[2:]}
_AUTOWARE: Final = "common control localization map perception planning sensing system v2x vehicle"

SOURCES: Final = (
    Source(
        "https://github.com/ros-navigation/navigation2",
        "Apache-2.0",
        {
            "nav2_msgs": "nav2_msgs",
            "dwb_msgs": "nav2_dwb_controller/dwb_msgs",
            "nav_2d_msgs": "nav2_dwb_controller/nav_2d_msgs",
        },
        _span(foxy="foxy-devel", **_EACH),
    ),
    Source(
        "https://github.com/ros/ros_tutorials",
        "BSD-3-Clause",
        {"turtlesim": "turtlesim", "turtlesim_msgs": "turtlesim"},
        _span(
            "noetic-devel", foxy="foxy-devel", galactic="galactic-devel", humble="humble", iron="iron", jazzy="rolling"
        ),
        only={"turtlesim_msgs": "kilted"},
    ),
    Source(
        "https://github.com/ros2/demos",
        "Apache-2.0",
        {"action_tutorials_interfaces": "action_tutorials/action_tutorials_interfaces"},
        _span(foxy="foxy", galactic="galactic", humble="humble", iron="iron", jazzy="jazzy"),
    ),
    Source(
        "https://github.com/moveit/moveit_msgs",
        "BSD-3-Clause",
        {"moveit_msgs": ""},
        _span("master", foxy="foxy", humble="humble", iron="iron", jazzy="ros2"),
    ),
    Source(
        "https://github.com/wg-perception/object_recognition_msgs",
        "BSD-3-Clause",
        {"object_recognition_msgs": ""},
        _span("noetic-devel", foxy="ros2"),
    ),
    Source(
        "https://github.com/OctoMap/octomap_msgs",
        "BSD-3-Clause",
        {"octomap_msgs": ""},
        _span("melodic-devel", foxy="foxy", galactic="ros2"),
    ),
    Source(
        "https://github.com/ros-planning/navigation_msgs",
        "BSD-3-Clause",
        {"map_msgs": "map_msgs"},
        _span("jade-devel", foxy="foxy", galactic="galactic", humble="humble", iron="iron", jazzy="rolling"),
    ),
    Source(
        "https://github.com/ros-controls/control_msgs",
        "BSD-3-Clause",
        {"control_msgs": "control_msgs"},
        _span(
            "kinetic-devel",
            foxy="foxy-devel",
            galactic="galactic-devel",
            humble="humble",
            jazzy="jazzy",
            kilted="master",
        ),
    ),
    Source(
        "https://github.com/ros-controls/ros2_control",
        "Apache-2.0",
        {"controller_manager_msgs": "controller_manager_msgs"},
        _span(
            foxy="foxy",
            galactic="galactic",
            humble="humble",
            iron="iron",
            jazzy="jazzy",
            kilted="kilted",
            lyrical="master",
        ),
    ),
    Source(
        "https://github.com/ros-drivers/ackermann_msgs",
        "BSD-3-Clause",
        {"ackermann_msgs": ""},
        _span("master", foxy="ros2"),
    ),
    Source(
        "https://github.com/ros-perception/vision_msgs",
        "Apache-2.0",
        {"vision_msgs": "vision_msgs"},
        _span("noetic-devel", foxy="foxy", galactic="galactic", humble="ros2"),
    ),
    Source(
        "https://github.com/ros-geographic-info/geographic_info",
        "BSD-3-Clause",
        {"geographic_msgs": "geographic_msgs"},
        _span("master", foxy="ros2"),
    ),
    Source(
        "https://github.com/ros-geographic-info/unique_identifier",
        "BSD-3-Clause",
        {"uuid_msgs": "uuid_msgs"},
        {"noetic": "master"},
    ),
    Source(
        "https://github.com/foxglove/foxglove-sdk",
        "MIT",
        {"foxglove_msgs": "ros/src/foxglove_msgs/ros2"},
        _span("main", foxy="main"),
        ros1="ros/src/foxglove_msgs/ros1",
    ),
    Source("https://github.com/PX4/px4_msgs", "BSD-3-Clause", {"px4_msgs": ""}, _span(foxy="release/1.16")),
    Source(
        "https://github.com/mavlink/mavros",
        "BSD-3-Clause",
        {"mavros_msgs": "mavros_msgs"},
        _span("master", foxy="ros2"),
    ),
    Source(
        "https://github.com/swri-robotics/gps_umd",
        "BSD-3-Clause",
        {"gps_msgs": "gps_msgs"},
        _span(foxy="ros2-devel"),
    ),
    Source(
        "https://github.com/cra-ros-pkg/robot_localization",
        "Apache-2.0",
        {"robot_localization": ""},
        _span("noetic-devel", foxy="foxy-devel", galactic="galactic-devel", humble="humble-devel", iron="ros2"),
    ),
    Source(
        "https://github.com/iRobotEducation/irobot_create_msgs",
        "BSD-3-Clause",
        {"irobot_create_msgs": ""},
        _span(foxy="foxy", galactic="galactic", humble="humble", iron="rolling"),
    ),
    Source(
        "https://github.com/ROBOTIS-GIT/turtlebot3_msgs",
        "Apache-2.0",
        {"turtlebot3_msgs": ""},
        _span("noetic", foxy="humble", jazzy="jazzy"),
    ),
    Source("https://github.com/christianrauch/apriltag_msgs", "MIT", {"apriltag_msgs": ""}, _span(foxy="master")),
    Source(
        "https://github.com/ros-industrial/ros_canopen",
        "BSD-3-Clause",
        {"can_msgs": "can_msgs"},
        _span("noetic", foxy="dashing-devel"),
    ),
    Source(
        "https://github.com/ANYbotics/grid_map",
        "BSD-3-Clause",
        {"grid_map_msgs": "grid_map_msgs"},
        _span("master", foxy="foxy-devel", galactic="humble", iron="iron", jazzy="jazzy", kilted="rolling"),
    ),
    Source(
        "https://github.com/ros-perception/pcl_msgs",
        "BSD-3-Clause",
        {"pcl_msgs": ""},
        _span("noetic-devel", foxy="ros2"),
    ),
    Source("https://github.com/ros-drivers/nmea_msgs", "BSD-3-Clause", {"nmea_msgs": ""}, _span("master", foxy="ros2")),
    Source(
        "https://github.com/ros-perception/radar_msgs", "Apache-2.0", {"radar_msgs": ""}, _span("noetic", foxy="ros2")
    ),
    Source(
        "https://github.com/ros-drivers/velodyne",
        "BSD-3-Clause",
        {"velodyne_msgs": "velodyne_msgs"},
        _span("master", foxy="ros2"),
    ),
    Source(
        "https://github.com/autowarefoundation/autoware_msgs",
        "Apache-2.0",
        {f"autoware_{part}_msgs": f"autoware_{part}_msgs" for part in _AUTOWARE.split()},
        _span(humble="main"),
    ),
)


def written(clones: Path) -> dict[str, str]:
    """Return what the files have to hold, by package."""
    return {package: _package(clones, source, package) for source in SOURCES for package in source.folders}


def _package(clones: Path, source: Source, package: str) -> str:
    git = _Git(_clone(clones, source.repository))
    runs: dict[str, list[tuple[str, str, str]]] = {}  # by name: text, first and last distribution
    first = DISTROS.index(source.only.get(package, DISTROS[0]))
    used = {distro: ref for distro, ref in source.refs.items() if DISTROS.index(distro) >= first}
    for distro, ref in used.items():
        folder = source.ros1 if distro == "noetic" and source.ros1 else source.folders[package]
        for name, text in git.definitions(ref, folder, package):
            known = runs.setdefault(name, [])
            if known and known[-1][0] == text and DISTROS.index(known[-1][2]) == DISTROS.index(distro) - 1:
                known[-1] = (text, known[-1][1], distro)
            else:
                known.append((text, distro, distro))
    refs = ", ".join(f"{ref} {git.commit(ref)}" for ref in dict.fromkeys(used.values()))
    holders = git.holders(next(reversed(used.values())))
    pieces = [
        f"# The interfaces of {package}: name, first and last distribution with this layout, fields and constants.\n"
        "# Written by `python -m tests.types.packages`.\n"
        f"# Source: {source.repository} ({refs})\n"
        f"# Licence: {source.licence}\n",
        *(f"# {holder}\n" for holder in holders or [f"Copyright the authors of {package}"]),
        "\n",
    ]
    for name, spans in sorted(runs.items()):
        pieces += [f"=== {name} {one} {last}\n{text}" for text, one, last in spans]
    return "".join(pieces)


class _Git:
    """One clone."""

    def __init__(self, path: Path) -> None:
        self._path = path

    def _run(self, *arguments: str) -> str:
        command = ["git", "-C", str(self._path), *arguments]
        return subprocess.run(command, capture_output=True, check=True).stdout.decode("utf-8", "replace")

    def commit(self, ref: str) -> str:
        return self._run("rev-parse", "--short=10", ref).strip()

    def holders(self, ref: str) -> list[str]:
        files = [file for file in self._run("ls-tree", "--name-only", ref).split("\n") if file.startswith("LICENSE")]
        bsd = [file for file in files if "BSD" in file] or files
        found = _COPYRIGHT.findall(self._run("show", f"{ref}:{bsd[0]}")) if bsd else []
        return [line for line in dict.fromkeys(found) if "[yyyy]" not in line and "{yyyy}" not in line]

    def definitions(self, ref: str, folder: str, package: str) -> Iterator[tuple[str, str]]:
        below = f"{folder}/" if folder else ""
        for path in self._run("ls-tree", "-r", "--name-only", ref, f"./{below}").split("\n"):
            found = _FILE.match(path)
            inside = path.removeprefix(below).count("/") <= (0 if "/ros" in folder else 1)
            if found is None or not inside:
                continue
            name = f"{package}/{found['kind']}/{found['name']}"
            text = self._run("show", f"{ref}:{path}")
            if found["kind"] == "srv" and "---" not in text:
                text += "\n---\n"  # ROS 1 takes it for a service that answers nothing
            yield name, "---\n".join(_plain(part) for part in _parts(name, text))


def _parts(name: str, text: str) -> list[Definition]:
    parts = {part.name: part for part in parse_interface(name, text)}
    return [parts[name + end] for end in PARTS[name.split("/")[1]]]


def _plain(definition: Definition) -> str:
    return Definition(definition.name, definition.fields, definition.constants).text()


def _clone(clones: Path, repository: str) -> Path:
    owner, name = repository.split("/")[-2:]
    for path in (clones / name, clones / f"{name}.git", clones / f"{owner}+{name}" / "repo"):
        if path.is_dir():
            return path
    raise FileNotFoundError(f"{clones} has no clone of {repository}")


if __name__ == "__main__":
    for package, text in written(Path(sys.argv[1])).items():
        (bundled.FOLDER / f"{package}.txt").write_text(text, "utf-8")
