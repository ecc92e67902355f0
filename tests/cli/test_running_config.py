"""ropeway config and ropeway route: a gateway in a process of its own is changed, killed, and started again."""

from __future__ import annotations

import json
import signal
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

from ropeway.control.client import ControlClient
from ropeway.errors import ControlError
from tests.support.messages import STRING
from tests.support.until import until


class Runner:
    """A gateway that ``ropeway run`` runs, and the verbs that ask it."""

    def __init__(self, directory: Path) -> None:
        self.file = directory / "robot.json"
        self.name = f"cli_{directory.name}".replace("-", "_")
        self.process: subprocess.Popen[str] | None = None

    def write(self, *names: str) -> None:
        items = [{"name": name, "type": STRING} for name in names]
        gateway = {"name": self.name, "graphs": ["memory:cli"], "listen": []}
        remotes = [{"address": "ws://127.0.0.1:9", "publish": items}]
        self.file.write_text(json.dumps({"gateway": gateway, "remotes": remotes}))

    async def start(self) -> None:
        command = [sys.executable, "-m", "ropeway", "run", str(self.file)]
        self.process = subprocess.Popen(  # noqa: ASYNC220 - for a moment
            command, stdout=subprocess.DEVNULL, stderr=subprocess.PIPE, text=True
        )
        await until(self.up)

    def up(self) -> bool:
        try:
            with ControlClient.find(self.name) as client:
                return bool(client.get("/v1/status"))
        except ControlError:
            return False

    def stop(self, how: signal.Signals) -> None:
        assert self.process is not None
        self.process.send_signal(how)
        self.process.communicate()

    def verb(self, *arguments: str) -> tuple[int, str]:
        command = [sys.executable, "-m", "ropeway", *arguments, "--gateway", self.name]
        done = subprocess.run(command, capture_output=True, text=True, timeout=60)
        return done.returncode, done.stdout + done.stderr

    def json(self, *arguments: str) -> Any:
        code, text = self.verb(*arguments, "--json")
        assert code == 0, text
        return json.loads(text)

    def routes(self) -> list[str]:
        return [route["name"] for route in self.json("route", "list")]


@pytest.fixture
def runner(tmp_path: Path) -> Iterator[Runner]:
    """A file with one route; whatever runs ends with the test."""
    made = Runner(tmp_path)
    made.write("/a")
    yield made
    if made.process is not None and made.process.poll() is None:
        made.process.kill()
        made.process.communicate()


async def test_changed_killed_and_restored(runner: Runner) -> None:
    """A route that was added is there again after kill -9, until the file is edited, which then wins."""
    await runner.start()
    code, text = runner.verb("route", "add", "ws://127.0.0.1:9", "publish", "/b", STRING, "-o", "rate_hz=5")
    assert (code, "+ start route publish /b" in text) == (0, True)
    runner.stop(signal.SIGKILL)
    await runner.start()
    assert runner.routes() == ["/a", "/b"]
    assert runner.verb("route", "pause", "/b")[0] == 0
    assert runner.verb("route", "rm", "/nope") == (1, "ropeway: there is no route /nope here\n")
    assert [entry["action"] for entry in runner.json("config", "history")] == ["route pause", "route add", "start"]
    runner.stop(signal.SIGTERM)
    runner.write("/edited")
    await runner.start()
    assert runner.routes() == ["/edited"]


async def test_the_verbs(runner: Runner) -> None:
    """A file is planned, applied, compared and taken back; one that is no good changes nothing, with exit status 2."""
    await runner.start()
    other = runner.file.with_name("other.json")
    other.write_text(runner.file.read_text().replace("/a", "/b"))
    plan = runner.json("config", "plan", str(other))
    assert [step["action"] for step in plan["steps"]] == ["start", "stop"]
    assert runner.verb("config", "diff", str(other))[0] == 1
    assert runner.json("config", "apply", str(other), "--note", "another")["applied"]
    assert runner.verb("config", "diff", str(other)) == (0, "")
    assert json.loads(runner.verb("config", "show")[1])["remotes"][0]["publish"][0]["name"] == "/b"
    assert runner.verb("config", "rollback")[0] == 0
    assert runner.routes() == ["/a"]
    other.write_text('{"gateway": {"wokers": 1}}')
    code, text = runner.verb("config", "apply", str(other))
    assert (code, 'unknown key; did you mean "workers"' in text) == (2, True)


async def test_sighup(runner: Runner) -> None:
    """SIGHUP has a gateway apply its file again."""
    await runner.start()
    runner.write("/a", "/c")
    assert runner.process is not None
    runner.process.send_signal(signal.SIGHUP)
    await until(lambda: runner.routes() == ["/a", "/c"])
