"""``ropeway run`` as a process: start, status, signals, failures."""

from __future__ import annotations

import json
import signal
import socket
import subprocess
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from tests.cli.conftest import Ropeway
from tests.support.until import PATIENCE_S

Start = Callable[..., subprocess.Popen[str]]


@pytest.fixture
def config(tmp_path: Path, environment: dict[str, str]) -> Callable[..., str]:
    """Writes a configuration on the domain of these tests."""

    def write(**gateway: Any) -> str:
        domain = f"dds:{environment['ROS_DOMAIN_ID']}"
        file = tmp_path / "gateway.json"
        file.write_text(json.dumps({"gateway": {"name": "here", "graphs": [domain], "listen": [], **gateway}}))
        return str(file)

    return write


def test_runs_for_a_time_and_tells_its_status(ropeway: Ropeway, config: Callable[..., str]) -> None:
    """``--for`` ends it with 0; ``--json`` prints status lines meanwhile."""
    result = ropeway("run", config(listen=["ws://127.0.0.1:0"]), "--for", "1.2", "--json", "--period", "0.2")
    assert result.returncode == 0, result.stderr
    lines = [json.loads(line) for line in result.stdout.splitlines()]
    assert len(lines) >= 3
    assert lines[-1]["name"] == "here"
    assert lines[-1]["listen"][0]["clients"] == 0
    assert "here is on dds:" in result.stderr


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_signals_end_it_in_order(background: Start, config: Callable[..., str], number: signal.Signals) -> None:
    """Ctrl-C and SIGTERM end it with status 0 and a last sentence."""
    process = background("run", config(), "--json", "--period", "0.1")
    assert process.stdout is not None
    process.stdout.readline()
    process.send_signal(number)
    _, err = process.communicate(timeout=PATIENCE_S)
    assert process.returncode == 0
    assert err.rstrip().endswith("here has ended")


def test_quiet_says_nothing(ropeway: Ropeway, config: Callable[..., str]) -> None:
    """With ``--quiet`` a healthy run is silent."""
    result = ropeway("run", config(), "--for", "0.2", "--quiet")
    assert (result.returncode, result.stdout, result.stderr) == (0, "", "")


def test_faulty_configurations_start_nothing(ropeway: Ropeway, tmp_path: Path) -> None:
    """A configuration with faults ends with 2 and its problems."""
    file = tmp_path / "bad.json"
    file.write_text('{"gateway": {"wokers": 1, "name": 3}}')
    result = ropeway("run", str(file))
    assert (result.returncode, result.stdout) == (2, "")
    assert result.stderr.splitlines()[0] == f"ropeway: {file}: gateway.name: expected a text, got 3"
    assert 'gateway.wokers: unknown key; did you mean "workers"?' in result.stderr
    missing = ropeway("run", str(tmp_path / "none.json"))
    assert missing.returncode == 2
    assert "cannot be read: No such file or directory" in missing.stderr


def test_a_port_in_use_is_a_failure(ropeway: Ropeway, config: Callable[..., str]) -> None:
    """What cannot be brought up ends with 1, a sentence, and no traceback."""
    with socket.socket() as taken:
        taken.bind(("127.0.0.1", 0))
        taken.listen()
        port = taken.getsockname()[1]
        result = ropeway("run", config(listen=[f"ws://127.0.0.1:{port}"]))
    assert result.returncode == 1
    assert str(port) in result.stderr
    assert "Traceback" not in result.stderr


def test_workers_are_supervised(background: Start, config: Callable[..., str]) -> None:
    """With workers, the status is that of all of them, and Ctrl-C ends them too."""
    process = background("run", config(workers=2), "--json", "--period", "0.2")
    assert process.stdout is not None
    status = json.loads(process.stdout.readline())
    assert [worker["name"] for worker in status["workers"]] == ["worker0", "worker1"]
    pids = [worker["pid"] for worker in status["workers"]]
    process.send_signal(signal.SIGINT)
    process.communicate(timeout=PATIENCE_S)
    assert process.returncode == 0
    deadline = time.monotonic() + PATIENCE_S
    while any(Path(f"/proc/{pid}").exists() for pid in pids):
        assert time.monotonic() < deadline, "a worker outlived its supervisor"
        time.sleep(0.05)
