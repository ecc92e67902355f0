"""``ropeway router``, ``ropeway overlay`` and ``overlay:`` graphs, as a user has them."""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest

from tests.cli.conftest import Ropeway
from tests.support.ports import free_endpoint
from tests.support.until import PATIENCE_S


class Place:
    """A fleet in a directory, with a running router."""

    def __init__(self, directory: Path, ropeway: Ropeway, environment: dict[str, str]) -> None:
        self.directory, self._ropeway, self._environment = directory, ropeway, environment
        self.endpoint = free_endpoint()

    def file(self, name: str) -> str:
        return str(self.directory / name)

    def run(self, *words: str) -> str:
        result = self._ropeway(*words)
        assert result.returncode == 0, result.stderr
        return result.stdout

    def fail(self, *words: str) -> str:
        result = self._ropeway(*words)
        assert result.returncode == 1
        return result.stderr

    def start(self, *words: str) -> subprocess.Popen[str]:
        command = [sys.executable, "-m", "ropeway", *words]
        return subprocess.Popen(
            command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True, env=self._environment
        )


@pytest.fixture
def place(tmp_path: Path, in_process: Ropeway, environment: dict[str, str]) -> Iterator[Place]:
    place = Place(tmp_path, in_process, {**os.environ, **environment})
    fleet = place.file("acme")
    place.run("keys", "init", "acme", "--directory", fleet, "--connect", place.endpoint)
    for name, *more in (("router1", "--router"), ("robot",), ("cloud",)):
        place.run("keys", "issue", name, "--fleet", fleet, "--output", place.file(f"{name}.ropeway"), *more)
    router = place.start("router", "-i", place.file("router1.ropeway"), "-l", place.endpoint, "--json")
    assert router.stdout is not None
    assert "listens" in json.loads(router.stdout.readline())["event"]
    yield place
    router.send_signal(signal.SIGTERM)
    _, errors = router.communicate(timeout=PATIENCE_S)
    assert router.returncode == 0
    assert "router1 has ended" in errors


@pytest.mark.timeout(600)  # a dozen processes, one after the other
def test_as_a_user(place: Place) -> None:
    """A topic published with one bundle is listed, traced and read with another, over a router."""
    robot = place.start(
        "topic", "pub", "/chatter", "std_msgs/msg/String", "{data: hi}", "-r", "20",
        "-g", f"overlay:{place.file('robot.ropeway')}",
    )  # fmt: skip
    graph, identity = f"overlay:{place.file('cloud.ropeway')}", place.file("cloud.ropeway")
    try:
        spin = ("--spin-time", "45")  # less, where all is found
        assert "data: hi" in place.run("topic", "echo", "/chatter", "--once", "-g", graph, *spin)
        listed = json.loads(place.run("overlay", "list", "-i", identity, "--json", *spin).splitlines()[0])
        assert (listed["name"], listed["member"]) == ("/chatter", "robot")
        name = place.run("name", "/chatter", "std_msgs/msg/String", "-i", identity).strip()
        assert listed["global"] == name
        for wanted in ("/chatter", name[:20]):
            said = place.run("overlay", "trace", wanted, "-i", identity, *spin)
            assert "sealed by    robot" in said
        capture = place.file("capture.jsonl")
        reader = place.start("topic", "echo", "/chatter", "-g", graph)
        try:
            place.run("overlay", "capture", "/chatter", "-i", identity, "-o", capture, "-n", "3", "--timeout", "120")
        finally:
            reader.terminate()
            reader.communicate(timeout=PATIENCE_S)
        said = place.run("overlay", "verify", capture, "--ca", place.file("acme/ca.pem"))
        assert said.count("signed by robot") == 3
        status = json.loads(place.run("overlay", "status", "-i", identity, "--json", *spin))
        assert [(g["name"], g["rtt_ms"] is not None) for g in status["gateways"]] == [("robot", True)]
        assert len(status["routers"]) == 1
    finally:
        robot.terminate()
        robot.communicate(timeout=PATIENCE_S)


@pytest.fixture
def nobody_there(monkeypatch: pytest.MonkeyPatch) -> None:
    """Wait less for a router where the test knows that none can be reached."""
    for module in ("cli.session", "cli.overlay.common"):
        monkeypatch.setattr(f"ropeway.{module}._LINK_S", 0.5)


def test_router_away(place: Place, nobody_there: None) -> None:
    """A verb whose router cannot be reached says so, with exit status 1."""
    assert "no router can be reached" in place.fail(
        "overlay", "status", "-i", place.file("cloud.ropeway"), "-r", free_endpoint()
    )


def test_mistakes(place: Place, ropeway: Ropeway) -> None:
    """What is no bundle, no topic or no endpoint says what to do, with exit status 1 or 2."""
    assert "nobody advertises /nobody" in place.fail(
        "overlay", "trace", "/nobody", "-i", place.file("cloud.ropeway"), "--spin-time", "0.5"
    )
    endpoint = ropeway("router", "-i", place.file("router1.ropeway"), "-l", "tcp/0.0.0.0:1")
    assert (endpoint.returncode, "tls/host:7447" in endpoint.stderr) == (2, True)
    member = ropeway("router", "-i", place.file("cloud.ropeway"))
    assert (member.returncode, "--router" in member.stderr) == (1, True)
    assert "keys issue" in place.fail("topic", "list", "-g", "overlay:nobody.ropeway")
    assert "router and unique" in place.fail("topic", "list", "-g", f"overlay:{place.file('cloud.ropeway')}?colour=red")


def test_revoking_twice(place: Place) -> None:
    """A revocation that reached nobody is pushed by the same command once a router can be reached."""
    fleet, operator = place.file("acme"), place.file("operator.ropeway")
    place.run("keys", "issue", "operator", "--fleet", fleet, "--output", operator)
    alone = place.file("alone.ropeway")
    place.run("keys", "issue", "alone", "--fleet", fleet, "--output", alone, "--connect", free_endpoint())
    failed = place.fail("keys", "revoke", "robot", "--fleet", fleet, "--push", alone)
    assert "can be reached" in failed
    assert "use --push" in place.fail("keys", "revoke", "robot", "--fleet", fleet)
    told = json.loads(place.run("keys", "revoke", "robot", "--fleet", fleet, "--push", operator, "--json"))
    assert (told["revoked"], told["told"]) == ([], 1)
    assert "it was before" in place.run("keys", "revoke", "robot", "--fleet", fleet, "--push", operator)


def test_no_router(place: Place, nobody_there: None) -> None:
    """A verb on an overlay whose router cannot be reached says why, with exit status 1."""
    robot = f"overlay:{place.file('robot.ropeway')}?router={free_endpoint()}"
    assert "no router can be reached" in place.fail("topic", "list", "-g", robot)
    other, bundle = place.file("other"), place.file("stranger.ropeway")
    place.run("keys", "init", "other", "--directory", other, "--connect", place.endpoint)
    place.run("keys", "issue", "stranger", "--fleet", other, "--output", bundle)
    assert "another fleet" in place.fail("topic", "list", "-g", f"overlay:{bundle}")
