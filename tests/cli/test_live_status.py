"""ropeway.cli.live_status: ``ropeway run`` on a terminal."""

from __future__ import annotations

import contextlib
import json
import os
import pty
import signal
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path

import pytest

from tests.support.until import PATIENCE_S


@pytest.fixture
def file(tmp_path: Path) -> str:
    """A configuration with a route to nobody, on a network inside the process."""
    remote = {"address": "ws://127.0.0.1:9", "publish": [{"name": "/odom", "type": "std_msgs/msg/String"}]}
    path = tmp_path / "gateway.json"
    gateway = {"name": "drawn", "graphs": ["memory:drawn"], "listen": [], "control": False}
    path.write_text(json.dumps({"gateway": gateway, "remotes": [remote]}))
    return str(path)


def run_on_terminal(
    environment: dict[str, str], *arguments: str, enough: Callable[[str], bool], log: int | None = None
) -> str:
    """Run the command on a terminal until it has printed enough, end it, and return all that it printed there."""
    ours, its = pty.openpty()
    process = subprocess.Popen(
        [sys.executable, "-m", "ropeway", "run", *arguments],
        stdin=its,
        stdout=its,
        stderr=its if log is None else log,
        env={**environment, "TERM": "xterm", "COLUMNS": "120", "LINES": "30"},
    )
    os.close(its)
    seen = ""
    with contextlib.suppress(OSError):  # as the other end of a terminal tells its end
        while not enough(seen):
            seen += os.read(ours, 4096).decode(errors="replace")
        process.send_signal(signal.SIGINT)
        while part := os.read(ours, 4096):
            seen += part.decode(errors="replace")
    os.close(ours)
    assert process.wait(PATIENCE_S) == 0
    return seen


def test_the_table_stands_below_the_log(environment: dict[str, str], file: str) -> None:
    """On a terminal the links and routes are drawn again and again, and the log is there, too."""
    seen = run_on_terminal(environment, file, enough=lambda seen: seen.count("/odom") >= 3)
    assert "drawn: links" in seen
    assert "drawn is on memory:drawn" in seen
    assert seen.rstrip().endswith("drawn has ended")


def test_a_plain_log(environment: dict[str, str], file: str) -> None:
    """With --no-live there is the log alone, also on a terminal."""
    seen = run_on_terminal(environment, file, "--no-live", "--for", "2.5", enough=lambda seen: "has ended" in seen)
    assert "drawn is on memory:drawn" in seen
    assert "links" not in seen


def test_a_log_that_goes_to_a_file(environment: dict[str, str], file: str, tmp_path: Path) -> None:
    """A log that is directed to a file stays out of the table."""
    with (tmp_path / "log").open("wb") as log:
        seen = run_on_terminal(environment, file, enough=lambda seen: seen.count("/odom") >= 2, log=log.fileno())
    assert "drawn is on" not in seen
    assert "drawn is on memory:drawn" in (tmp_path / "log").read_text()
