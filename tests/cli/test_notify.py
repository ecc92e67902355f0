"""What a service manager is told."""

from __future__ import annotations

import asyncio
import json
import os
import signal
import socket
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest

from ropeway.cli.notify import Notifier, notifying
from tests.support.until import PATIENCE_S


class Manager:
    """Stands at the other end of the socket."""

    def __init__(self, address: str) -> None:
        self.environ = {"NOTIFY_SOCKET": address.replace("\0", "@")}
        self._socket = socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM)
        self._socket.bind(address)
        self._socket.settimeout(PATIENCE_S)

    def heard(self) -> list[str]:
        """Return the lines of the next datagram."""
        return self._socket.recv(4096).decode().split("\n")

    def until(self, line: str) -> list[list[str]]:
        """Return all datagrams up to the one with ``line``."""
        found = [self.heard()]
        while line not in found[-1]:
            found.append(self.heard())
        return found

    def close(self) -> None:
        self._socket.close()


@pytest.fixture(params=["path", "abstract"])
def manager(request: pytest.FixtureRequest, tmp_path: Path) -> Iterator[Manager]:
    """A manager that listens at a path, or at an abstract name."""
    address = str(tmp_path / "notify") if request.param == "path" else f"\0ropeway-test-{os.getpid()}-{id(request)}"
    found = Manager(address)
    yield found
    found.close()


def test_each_word(manager: Manager) -> None:
    """The manager hears each change of state as its protocol writes it, a status in one line."""
    notifier = Notifier(manager.environ)
    notifier.ready("two\nlines")
    notifier.reloading()
    notifier.status("waiting")
    notifier.stopping()
    assert manager.heard() == ["READY=1", "STATUS=two lines"]
    word, stamp = manager.heard()
    assert word == "RELOADING=1"
    assert int(stamp.removeprefix("MONOTONIC_USEC=")) > 0
    assert manager.heard() == ["STATUS=waiting"]
    assert manager.heard() == ["STOPPING=1"]


def test_nobody_to_tell(caplog: pytest.LogCaptureFixture) -> None:
    """Without a manager nothing is told; one that is gone is a warning."""
    Notifier({}).ready("here")
    assert caplog.messages == []
    Notifier({"NOTIFY_SOCKET": "/nowhere/notify"}).stopping()
    assert "cannot be told STOPPING=1" in caplog.text


@pytest.mark.parametrize(
    ("environ", "seconds"),
    [
        ({"WATCHDOG_USEC": "3000000"}, 1.0),
        ({"WATCHDOG_USEC": "3000000", "WATCHDOG_PID": str(os.getpid())}, 1.0),
        ({"WATCHDOG_USEC": "60000000"}, 5.0),
        ({"ROPEWAY_ALIVE_FILE": "/tmp/alive"}, 5.0),
        ({"WATCHDOG_USEC": "3000000", "WATCHDOG_PID": "1"}, 0.0),
        ({"WATCHDOG_USEC": "soon"}, 0.0),
        ({}, 0.0),
    ],
)
def test_how_often_it_beats(environ: dict[str, str], seconds: float) -> None:
    """The time between two beats follows from the environment, where that is meant for this process."""
    assert Notifier({"NOTIFY_SOCKET": "/run/notify", **environ}).beat_s == seconds


def test_the_file_of_health_checks(tmp_path: Path) -> None:
    """The file is there, and touched with each beat, from ready to stopping."""
    file = tmp_path / "alive"
    notifier = Notifier({"ROPEWAY_ALIVE_FILE": str(file)})
    notifier.alive()
    assert not file.exists()
    notifier.ready("here")
    os.utime(file, (0, 0))
    notifier.alive()
    assert file.stat().st_mtime > 0
    notifier.stopping()
    notifier.alive()
    assert not file.exists()


async def test_watchdog(manager: Manager) -> None:
    """While the block runs the manager is told again and again that the loop turns."""
    async with notifying(Notifier({**manager.environ, "WATCHDOG_USEC": "30000"})) as notifier:
        assert notifier.beat_s == 0.01
        for _ in range(3):
            assert await asyncio.to_thread(manager.heard) == ["WATCHDOG=1"]


def test_a_gateway_as_a_service(manager: Manager, environment: dict[str, str], tmp_path: Path) -> None:
    """A gateway tells that it is ready, alive, reloading and stopping, in this order."""
    config = tmp_path / "gateway.json"
    config.write_text(json.dumps({"gateway": {"name": "here", "graphs": ["memory:service"], "listen": []}}))
    environ = {**environment, **manager.environ, "WATCHDOG_USEC": "300000"}
    process = subprocess.Popen([sys.executable, "-m", "ropeway", "run", str(config)], env=environ)
    try:
        assert manager.until("READY=1")[-1] == ["READY=1", "STATUS=running"]
        assert manager.until("WATCHDOG=1")
        process.send_signal(signal.SIGHUP)
        assert any(lines[0] == "RELOADING=1" for lines in manager.until("READY=1"))
        process.send_signal(signal.SIGTERM)
        assert manager.until("STOPPING=1")
        assert process.wait(PATIENCE_S) == 0
    finally:
        process.kill()
        process.wait()
