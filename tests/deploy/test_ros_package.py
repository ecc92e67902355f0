"""The package for a ROS 2 workspace."""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
from collections.abc import Callable, Iterator
from pathlib import Path
from types import ModuleType
from xml.etree import ElementTree

import pytest
import yaml

from tests.deploy.place import ROOT
from tests.support.until import PATIENCE_S

Ros2 = Callable[..., subprocess.CompletedProcess[str]]


@pytest.fixture
def program(monkeypatch: pytest.MonkeyPatch) -> Iterator[ModuleType]:
    """The module that finds Ropeway."""
    monkeypatch.syspath_prepend(str(ROOT / "ros"))
    import ropeway_ros.program

    yield ropeway_ros.program
    for name in [name for name in sys.modules if name.startswith("ropeway_ros")]:
        del sys.modules[name]


def test_which_ropeway(program: ModuleType, monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    """The variable goes before this Python's, which goes before the one on the path; without any it says what to do."""
    monkeypatch.setenv("ROPEWAY", "/opt/ropeway/bin/ropeway")
    assert program.command("run", "x.yaml") == ["/opt/ropeway/bin/ropeway", "run", "x.yaml"]
    monkeypatch.delenv("ROPEWAY")
    found = program.command("--version")
    assert subprocess.run(found, capture_output=True, text=True, check=True).stdout.startswith("ropeway ")
    monkeypatch.setattr(program.importlib.util, "find_spec", lambda _: None)
    (tmp_path / "ropeway").touch(0o755)
    monkeypatch.setenv("PATH", str(tmp_path))
    assert program.command("server") == [str(tmp_path / "ropeway"), "server"]
    monkeypatch.setenv("PATH", "/nowhere")
    with pytest.raises(program.NotInstalled, match="pip install ropeway"):
        program.command("server")


def test_what_launch_files_add(program: ModuleType) -> None:
    """ROS arguments are taken out of the command line of a gateway, and nothing else."""
    given = ["robot.yaml", "--ros-args", "-r", "__node:=g", "--", "--quiet", "--ros-args", "-p", "a:=1"]
    assert program.without_ros_arguments(given) == ["robot.yaml", "--quiet"]


@pytest.mark.parametrize(
    ("launch", "words"), [("rosbridge_websocket_launch.xml", []), ("foxglove_bridge_launch.xml", ["--foxglove"])]
)
def test_parameters_of_launch_files(launch: str, words: list[str], tmp_path: Path) -> None:
    """Every argument of a launch file is a parameter that the server takes, with the default that it has there."""
    tree = ElementTree.parse(ROOT / "ros" / "launch" / launch).getroot()
    defaults = {arg.get("name"): arg.get("default") or "" for arg in tree.iter("arg")}
    names = {param.get("name"): param.get("type") for param in tree.iter("param")}
    assert defaults.keys() - names.keys() <= {"ssl"}  # which says whether there is a certificate
    values = {
        name: defaults[name] if type == "str" or name in ("certfile", "keyfile") else yaml.safe_load(defaults[name])
        for name, type in names.items()
    }
    params = tmp_path / "params.yaml"
    params.write_text(yaml.safe_dump({"/**": {"ros__parameters": {**values, "graph": "memory:launched", "port": 0}}}))
    command = [str(Path(sys.executable).with_name("ropeway")), "server", *words, "--for", "0.1", "--ros-args"]
    done = subprocess.run(
        [*command, "--params-file", str(params)], capture_output=True, text=True, timeout=PATIENCE_S, check=False
    )
    assert done.returncode == 0, done.stderr


@pytest.fixture(scope="module")
def ros2(tmp_path_factory: pytest.TempPathFactory) -> Ros2:
    """The command ``ros2``, in a workspace in which colcon has built the package."""
    for tool in ("ros2", "colcon"):
        if shutil.which(tool) is None:
            pytest.skip("needs a sourced ROS 2 with colcon")
    workspace = tmp_path_factory.mktemp("workspace")
    subprocess.run(["colcon", "build", "--base-paths", str(ROOT / "ros")], cwd=workspace, check=True)
    environ = {**os.environ, "ROPEWAY": str(Path(sys.executable).with_name("ropeway"))}

    def run(*arguments: str) -> subprocess.CompletedProcess[str]:
        words = ["bash", "-c", 'source install/setup.bash && exec ros2 "$@"', "ros2", *arguments]
        return subprocess.run(
            words, cwd=workspace, env=environ, capture_output=True, text=True, timeout=3 * PATIENCE_S, check=False
        )

    return run


@pytest.mark.ros
@pytest.mark.slow
def test_verbs(ros2: Ros2) -> None:
    """``ros2 ropeway`` passes its words on, and gives back the exit status."""
    assert "topic" in ros2("ropeway", "help").stdout
    listed = ros2("ropeway", "topic", "list", "-g", "memory:here")
    assert (listed.returncode, listed.stdout) == (0, ""), listed.stderr
    assert ros2("ropeway", "topic", "lost").returncode == 2


@pytest.mark.ros
@pytest.mark.slow
@pytest.mark.parametrize(
    ("file", "arguments"),
    [
        ("gateway_launch.xml", ["config", "log_level"]),
        ("rosbridge_websocket_launch.xml", ["port"]),
        ("foxglove_bridge_launch.xml", ["port", "topic_whitelist"]),
    ],
)
def test_launch_files(ros2: Ros2, file: str, arguments: list[str]) -> None:
    """The launch files are installed, and show what they take."""
    shown = ros2("launch", "ropeway", file, "--show-args").stdout
    for argument in arguments:
        assert f"'{argument}'" in shown


@pytest.mark.ros
@pytest.mark.slow
@pytest.mark.timeout(1800)
def test_launch_tests_of_rosbridge(ros2: Ros2, tmp_path: Path) -> None:
    """rosbridge_suite's launch tests, of the directory ``ROSBRIDGE_LAUNCH_TESTS``, pass with our node in its place."""
    tests = os.environ.get("ROSBRIDGE_LAUNCH_TESTS")
    if tests is None:
        pytest.skip("needs ROSBRIDGE_LAUNCH_TESTS, a directory with rosbridge_server/test/websocket")
    place = tmp_path / "lib/rosbridge_server"
    shutil.copytree(ROOT / "ros/scripts", place)
    index = tmp_path / "share/ament_index/resource_index/packages"
    index.mkdir(parents=True)
    (index / "rosbridge_server").touch()
    environ = {
        **os.environ,
        "AMENT_PREFIX_PATH": f"{tmp_path}{os.pathsep}{os.environ['AMENT_PREFIX_PATH']}",
        "PYTHONPATH": f"{ROOT / 'ros'}{os.pathsep}{os.environ.get('PYTHONPATH', '')}",
        "ROPEWAY": str(Path(sys.executable).with_name("ropeway")),
        "ROS_DOMAIN_ID": str(110 + os.getpid() % 100),
        "ROS_AUTOMATIC_DISCOVERY_RANGE": "LOCALHOST",
    }
    failed = [
        test.name
        for test in sorted(Path(tests).glob("*.test.py"))
        if subprocess.run(["launch_test", str(test)], env=environ, timeout=5 * PATIENCE_S, check=False).returncode
    ]
    assert failed == []
