"""What the tests of the command line share."""

from __future__ import annotations

import os
import subprocess
import sys
from collections.abc import AsyncIterator, Callable, Iterator
from pathlib import Path

import pytest
from typer.testing import CliRunner

from ropeway.cli import app
from ropeway.cli.session import OpenGraph
from ropeway.networks.memory.graph import MemoryGraph
from ropeway.types import TypeRegistry
from tests.support.until import PATIENCE_S

Ropeway = Callable[..., subprocess.CompletedProcess[str]]


@pytest.fixture(scope="session")
def registry() -> TypeRegistry:
    """The types of the newest distribution; tests add none to it."""
    return TypeRegistry()


@pytest.fixture
async def pair(registry: TypeRegistry, request: pytest.FixtureRequest) -> AsyncIterator[tuple[OpenGraph, OpenGraph]]:
    """Two participants of one network inside this process."""
    name = request.node.name.replace("[", "-").replace("]", "")
    graphs = [MemoryGraph(name, node=node) for node in ("/here", "/there")]
    for graph in graphs:
        await graph.open()
    yield OpenGraph(graphs[0], registry), OpenGraph(graphs[1], registry)
    for graph in graphs:
        await graph.close()


@pytest.fixture(scope="session")
def environment() -> dict[str, str]:
    """The environment of subprocesses: DDS stays on this machine, and among the processes of this test run."""
    source = str(Path(__file__).parents[2] / "src")
    kept = {key: value for key, value in os.environ.items() if not key.startswith(("ROS_", "ROPEWAY_", "AMENT_"))}
    path = os.pathsep.join(filter(None, (source, kept.get("PYTHONPATH"))))
    domain = str(110 + os.getpid() % 100)
    return {**kept, "PYTHONPATH": path, "ROS_AUTOMATIC_DISCOVERY_RANGE": "LOCALHOST", "ROS_DOMAIN_ID": domain}


@pytest.fixture(scope="session")
def ropeway(environment: dict[str, str]) -> Ropeway:
    """Runs the command to its end."""

    def run(*arguments: str, timeout_s: float = PATIENCE_S, **more: str) -> subprocess.CompletedProcess[str]:
        return subprocess.run(
            [sys.executable, "-m", "ropeway", *arguments],
            capture_output=True,
            text=True,
            timeout=timeout_s,
            env={**environment, **more},
            check=False,
        )

    return run


@pytest.fixture
def in_process(environment: dict[str, str], monkeypatch: pytest.MonkeyPatch) -> Ropeway:
    """Runs the command to its end without a process of its own: for verbs that begin no logs and end by themselves."""
    for name in os.environ.keys() - environment.keys():
        monkeypatch.delenv(name)
    for name, value in environment.items():
        monkeypatch.setenv(name, value)

    def run(*arguments: str) -> subprocess.CompletedProcess[str]:
        result = CliRunner().invoke(app, arguments)
        if result.exception is not None and not isinstance(result.exception, SystemExit):
            raise result.exception
        return subprocess.CompletedProcess(arguments, result.exit_code, result.stdout, result.stderr)

    return run


@pytest.fixture
def background(environment: dict[str, str]) -> Iterator[Callable[..., subprocess.Popen[str]]]:
    """Starts the command and ends it after the test."""
    started: list[subprocess.Popen[str]] = []

    def start(*arguments: str) -> subprocess.Popen[str]:
        process = subprocess.Popen(
            [sys.executable, "-m", "ropeway", *arguments],
            stdout=subprocess.PIPE,
            stderr=subprocess.PIPE,
            text=True,
            env=environment,
            pipesize=1 << 20,  # nobody reads what the command prints while a test is at something else
        )
        started.append(process)
        return process

    yield start
    for process in started:
        if process.poll() is None:
            process.terminate()
        process.communicate(timeout=PATIENCE_S)
