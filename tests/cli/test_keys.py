"""``ropeway keys`` and ``ropeway name``."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import pytest
from typer.testing import CliRunner, Result

from ropeway.cli import app
from ropeway.networks.overlay.crypto.identity import Identity
from ropeway.networks.overlay.crypto.trust import Trust
from ropeway.networks.overlay.names import global_name


@pytest.fixture(autouse=True)
def here(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """An empty directory to work in."""
    monkeypatch.chdir(tmp_path)
    return tmp_path


def run(*words: str) -> Result:
    return CliRunner().invoke(app, list(words))


def done(*words: str) -> str:
    result = run(*words)
    assert result.exit_code == 0, result.output
    return result.stdout


def data(*words: str) -> Any:
    return json.loads(done(*words, "--json"))


def test_a_fleet_and_its_members() -> None:
    """A fleet, a router and two members are four commands, and each says what comes next."""
    assert "keys issue" in done("keys", "init", "acme", "--connect", "tls/r:7447")
    assert "router1.ropeway" in done("keys", "issue", "router1", "--router")
    said = done("keys", "issue", "robot1", "--may-publish", "/camera/*", "--may-call", "*")
    assert "may publish   /camera/*" in said
    assert "may subscribe nothing" in said
    robot = Identity.load("robot1.ropeway")
    assert robot.routers == ("tls/r:7447",)
    assert not robot.certificate.rights.may("publish", "/odom")
    cloud = data("keys", "issue", "cloud")
    assert cloud["rights"]["offer"] == ["*"]
    assert [row["name"] for row in data("keys", "show", "acme")["issued"]] == ["router1", "robot1", "cloud"]
    assert "robot1" in done("keys", "show", "robot1.ropeway")
    assert data("keys", "show", "cloud.ropeway")["problem"] == ""


def test_secrets_stay(here: Path) -> None:
    """Nothing that is printed holds a key or the name secret."""
    printed = done("keys", "init", "acme") + done("keys", "issue", "robot1") + done("keys", "show", "robot1.ropeway")
    printed += done("keys", "issue", "robot2", "--json") + done("keys", "show", "acme", "--json")
    secret = (here / "acme" / "name.secret").read_text().strip()
    assert secret not in printed
    assert "PRIVATE" not in printed


def test_a_key_that_stays(here: Path) -> None:
    """A machine that makes its own key has it signed elsewhere; the key is in no file that travels."""
    done("keys", "init", "acme")
    assert "keys sign" in done("keys", "request", "robot1")
    assert "keys join" in done("keys", "sign", "robot1.csr", "--may-subscribe", "/a")
    key = (here / "robot1.key").read_text().splitlines()[1]
    assert key not in (here / "robot1.csr").read_text()
    assert key not in (here / "robot1.signed").read_text()
    done("keys", "join", "robot1.signed", "robot1.key")
    identity = Identity.load("robot1.ropeway")
    assert identity.certificate.rights.may("subscribe", "/a")
    done("keys", "request", "other")
    result = run("keys", "join", "robot1.signed", "other.key", "--output", "x.ropeway")
    assert result.exit_code == 1
    assert "do not go together" in result.stderr
    assert not (here / "x.ropeway").exists()


def test_revoking_and_renewing(here: Path) -> None:
    """A member is revoked with a list that grows, and renewed with the rights it had."""
    done("keys", "init", "acme")
    done("keys", "issue", "robot1", "--may-call", "/x")
    old = Identity.load("robot1.ropeway")
    assert run("keys", "renew", "robot1").exit_code == 2
    assert run("keys", "renew", "robot1", "--output", "robot1.ropeway").exit_code == 1
    done("keys", "renew", "robot1", "--replace", "robot1.ropeway", "--days", "2")
    new = Identity.load("robot1.ropeway")
    assert new.certificate.serial != old.certificate.serial
    assert new.certificate.rights == old.certificate.rights
    assert "--push" in done("keys", "revoke", "robot1")
    trust = Trust(old.ca, (here / "acme" / "crl.pem").read_bytes())
    assert trust.revoked(old.certificate.serial)
    assert trust.revoked(new.certificate.serial)
    result = run("keys", "revoke", "robot1")
    assert (result.exit_code, "revoked already" in result.stderr) == (1, True)


def test_mistakes(here: Path) -> None:
    """Without a fleet, with a bundle that is there, a bad name or pattern, it is said what to do."""
    assert "keys init" in run("keys", "issue", "robot1").stderr
    done("keys", "init", "acme")
    done("keys", "issue", "robot1")
    assert "never overwritten" in run("keys", "issue", "robot1").stderr
    assert "letters, digits" in run("keys", "issue", "ro bot").stderr
    assert "absolute names" in run("keys", "issue", "robot2", "--may-publish", "camera").stderr
    assert not (here / "robot2.ropeway").exists()
    assert "keys issue" in run("keys", "show", "nobody.ropeway").stderr
    done("keys", "init", "other")
    assert "2 fleets" in run("keys", "issue", "robot3").stderr
    assert "signing request" in run("keys", "sign", "robot1.ropeway", "--fleet", "acme").stderr


def test_files_that_cannot_be_used(here: Path) -> None:
    """A file that is no text, damaged, or far too large is refused in a sentence by every verb that reads one."""
    done("keys", "init", "acme")
    done("keys", "issue", "good")
    done("keys", "request", "robot1")
    (here / "binary").write_bytes(bytes(range(256)) * 10)
    with (here / "large").open("wb") as file:
        file.truncate(17 << 20)
    for name in ("binary", "large", "acme"):
        for words in (
            ("keys", "sign", name),
            ("keys", "show", "./" + name) if name != "acme" else ("keys", "sign", "missing.csr"),
            ("keys", "join", name, "robot1.key"),
            ("keys", "join", "good.ropeway", name),
            ("keys", "revoke", "good", "--push", name),
            ("overlay", "verify", "binary", "--ca", name),
            ("overlay", "verify", "binary", "--ca", "acme/ca.pem", "--crl", name),
        ):
            result = run(*words, *(("--fleet", "acme") if words[1] in ("sign", "revoke") else ()))
            assert result.exit_code == 1, words
            assert isinstance(result.exception, SystemExit), words
            assert result.stderr.count("\n") == 1, words


def test_names() -> None:
    """A global name is that of the library, for topics, services and actions, and members only make it."""
    done("keys", "init", "acme")
    done("keys", "issue", "robot1")
    done("keys", "issue", "router1", "--router")
    secret = Identity.load("robot1.ropeway").name_secret
    assert secret is not None
    image = ("/camera", "sensor_msgs/msg/Image")
    assert done("name", *image, "-i", "robot1.ropeway").strip() == global_name(secret, "topic", *image).hex()
    assert data("name", "/add", "p/srv/Add", "-i", "robot1.ropeway")["kind"] == "service"
    assert (
        done("name", "/camera", "sensor_msgs/Image", "-i", "robot1.ropeway").strip()
        == global_name(secret, "topic", *image).hex()
    )
    assert done("name", *image, "-i", "robot1.ropeway", "--unique", "x") != done("name", *image, "-i", "robot1.ropeway")
    assert "router" in run("name", *image, "-i", "router1.ropeway").stderr


def test_names_of_an_action() -> None:
    """An action has the names of the services and topics that it is made of: those that are advertised."""
    done("keys", "init", "acme")
    done("keys", "issue", "robot1")
    secret = Identity.load("robot1.ropeway").name_secret
    assert secret is not None
    action = ("name", "/fib", "example_interfaces/action/Fibonacci", "-i", "robot1.ropeway")
    told = data(*action)
    assert told["kind"] == "action"
    assert {row["name"]: row["type"] for row in told["advertised"]} == {
        "/fib/_action/send_goal": "example_interfaces/action/Fibonacci_SendGoal",
        "/fib/_action/cancel_goal": "action_msgs/srv/CancelGoal",
        "/fib/_action/get_result": "example_interfaces/action/Fibonacci_GetResult",
        "/fib/_action/feedback": "example_interfaces/action/Fibonacci_FeedbackMessage",
        "/fib/_action/status": "action_msgs/msg/GoalStatusArray",
    }
    for row in told["advertised"]:
        assert row["global"] == global_name(secret, row["kind"], row["name"], row["type"]).hex()
        assert f"{row['global']}  {row['kind']}" in done(*action)
