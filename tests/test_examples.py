"""The programs in examples/, each in a process of its own, as a user runs it."""

from __future__ import annotations

import ast
import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest

from ropeway import blocking
from tests.support.isolation import isolated_dds

EXAMPLES = Path(__file__).parents[1] / "examples"
PROGRAMS = sorted(EXAMPLES.glob("*.py"))
ONE, OTHER = "dds:58?interface=lo", "dds:59?interface=lo"
LIMIT_S = 50


@pytest.fixture(scope="module", autouse=True)
def dds_isolation() -> Iterator[None]:
    """Participants of this test run discover each other only."""
    with isolated_dds():
        yield


@contextmanager
def running(name: str, *arguments: str) -> Iterator[Iterator[str]]:
    """Run an example until the end of the block; give the lines that it prints."""
    command = [sys.executable, "-u", "-W", "error", str(EXAMPLES / name), *arguments]
    with subprocess.Popen(command, stdout=subprocess.PIPE, text=True) as process:
        assert process.stdout is not None
        try:
            yield process.stdout
        finally:
            process.kill()


def run(name: str, *arguments: str) -> list[str]:
    """Run an example to its end; return the lines that it printed."""
    command = [sys.executable, "-W", "error", str(EXAMPLES / name), *arguments]
    done = subprocess.run(command, capture_output=True, text=True, timeout=LIMIT_S, check=False)
    assert (done.returncode, done.stderr) == (0, "")
    return done.stdout.splitlines()


def test_they_are_listed() -> None:
    """Each program is in the list, has at most 40 lines, and says at its top what it does and how to run it."""
    readme = (EXAMPLES / "README.md").read_text()
    assert len(PROGRAMS) == 10
    for path in PROGRAMS:
        text = path.read_text()
        assert f"[{path.name}]({path.name})" in readme
        assert len(text.splitlines()) <= 40
        assert f"python examples/{path.name}" in (ast.get_docstring(ast.parse(text)) or "")


def test_publish_and_echo() -> None:
    """What one program publishes, another prints."""
    with running("publish.py", ONE), running("echo.py", "/chatter", ONE) as lines:
        assert next(lines) == "reading /chatter, a std_msgs/msg/String\n"
        assert next(lines).startswith('{"data":"hello ')


def test_forward() -> None:
    """What is published on one domain is printed on another."""
    with (
        running("publish.py", ONE),
        running("forward.py", "/chatter", ONE, OTHER),
        running("echo.py", "/chatter", OTHER) as lines,
    ):
        assert next(lines) == "reading /chatter, a std_msgs/msg/String\n"
        assert next(lines).startswith('{"data":"hello ')


def test_service() -> None:
    """A program calls the service that another offers."""
    with running("offer_service.py", ONE) as lines:
        assert next(lines) == "serving /add\n"
        assert run("call_service.py", "1", "2", ONE) == ["3"]
        assert next(lines) == "adding 1 and 2\n"


def test_no_service() -> None:
    """A program that calls a service that nobody offers says so."""
    command = [sys.executable, str(EXAMPLES / "call_service.py"), "1", "2", "memory:empty"]
    done = subprocess.run(command, capture_output=True, text=True, timeout=LIMIT_S, check=False)
    assert done.returncode == 1
    assert done.stderr.startswith("nobody serves /add on memory:empty; run ")


def test_action() -> None:
    """A goal is carried out with feedback."""
    lines = run("action.py")
    assert lines[0] == "so far: [0, 1, 1]"
    assert lines[-1].startswith("SUCCEEDED <example_interfaces/action/Fibonacci_Result")


def test_bridge() -> None:
    """A topic and a service cross between two networks."""
    assert run("bridge.py") == [
        "the cloud reads 0.75",
        "the robot is told: go left",
        "topic /battery active",
        "service /plan active",
    ]


def test_gateway() -> None:
    """Two gateways show their routes, which wait for publishers and readers."""
    lines = run("gateway.py", "1")
    assert [line.rpartition(" ")[0] for line in lines] == ["publish /odom", "subscribe /cmd_vel"]


def test_rosbridge_client() -> None:
    """A client publishes at a gateway and sees its topics."""
    config = {"gateway": {"graphs": ["memory:examples"], "listen": ["ws://127.0.0.1:0"]}}
    with blocking.open_gateway(config) as gateway:
        assert "/cmd_vel geometry_msgs/msg/Twist" in run("rosbridge_client.py", f"ws://127.0.0.1:{gateway.ports[0]}")


def test_iort_node(tmp_path: Path) -> None:
    """A node publishes and reads its value at a gateway."""
    config = {
        "gateway": {
            "graphs": ["memory:examples"],
            "listen": ["iort://127.0.0.1:0"],
            "store": {"path": str(tmp_path / "values")},
        }
    }
    with blocking.open_gateway(config) as gateway:
        port = gateway.status()["nodes"]["listen"][0]["port"]
        assert run("iort_node.py", f"iort://127.0.0.1:{port}") == ["battery: 80 mode: remote"]
