"""``ropeway config``."""

from __future__ import annotations

import json
from pathlib import Path

from typer.testing import CliRunner

from ropeway.cli import app
from ropeway.gateway.config.config import Config

GOOD = [
    {
        "address": "ws://alice",
        "publish": [{"name": "/a", "type": "std_msgs/String"}],
        "subscribe": [{"name": "/b", "type": "std_msgs/String", "remote_name": "/c"}],
    }
]
BAD = [{"address": "ws://alice", "publish": [{"name": "/a", "type": "std_msgs/String", "compresion": "zip"}]}]


def test_check_of_a_valid_file(tmp_path: Path) -> None:
    """A valid file gives status 0 and its routes."""
    file = tmp_path / "good.json"
    file.write_text(json.dumps(GOOD))
    result = CliRunner().invoke(app, ["config", "check", str(file)])
    assert result.exit_code == 0
    assert "remotes[0].publish[0]: /a [std_msgs/msg/String] -> ws://alice:9090\n" in result.stdout
    assert "remotes[0].subscribe[0]: /b [std_msgs/msg/String] <- ws://alice:9090 as /c\n" in result.stdout
    assert "is valid: 1 remote(s), 2 route(s)." in result.stdout


def test_check_of_a_faulty_file(tmp_path: Path) -> None:
    """A faulty file gives status 2 and each fault on stderr with file, path and nearest key."""
    file = tmp_path / "bad.json"
    file.write_text(json.dumps(BAD))
    result = CliRunner().invoke(app, ["config", "check", str(file)])
    assert result.exit_code == 2
    assert result.stdout == ""
    assert result.stderr.startswith(f"{file}: remotes[0].publish[0].compresion: unknown key; did you mean")
    assert "1 problem; nothing would start." in result.stderr


def test_check_as_json(tmp_path: Path) -> None:
    """With ``--json`` both results are one JSON value on stdout."""
    for value, valid, code in ((GOOD, True, 0), (BAD, False, 2)):
        file = tmp_path / "a.json"
        file.write_text(json.dumps(value))
        result = CliRunner().invoke(app, ["config", "check", "--json", str(file)])
        assert result.exit_code == code
        told = json.loads(result.stdout)
        assert told["valid"] is valid
        assert (told["routes"][0]["name"] if valid else told["problems"][0]["path"]) in (
            "/a",
            "remotes[0].publish[0].compresion",
        )


def test_check_of_a_missing_file(tmp_path: Path) -> None:
    """A file that is not there is a configuration error."""
    result = CliRunner().invoke(app, ["config", "check", str(tmp_path / "none.yaml")])
    assert result.exit_code == 2
    assert "No such file" in result.stderr


def test_schema() -> None:
    """``config schema`` prints the JSON Schema."""
    for options in ([], ["--json"]):
        result = CliRunner().invoke(app, ["config", "schema", *options])
        assert result.exit_code == 0
        assert json.loads(result.stdout) == Config.schema()


def test_check_of_many_gateways(tmp_path: Path) -> None:
    """A document for many gateways is checked as a whole, or one of them with --as."""
    gateway = {"graphs": ["memory:a"], "listen": ["ws://127.0.0.1:9090"]}
    members = {"cloud": {"gateway": gateway}, "robot": {"gateway": {**gateway, "listen": []}, "remotes": GOOD}}
    file = tmp_path / "fleet.json"
    file.write_text(json.dumps({"gateways": members}))
    result = CliRunner().invoke(app, ["config", "check", str(file)])
    assert result.exit_code == 0, result.stderr
    assert "cloud: 0 remote(s), 0 route(s)\nrobot: 1 remote(s), 2 route(s)\n" in result.stdout
    assert f"{file} is valid: 2 gateways." in result.stdout
    told = json.loads(CliRunner().invoke(app, ["config", "check", str(file), "--json"]).stdout)
    assert list(told["gateways"]) == ["cloud", "robot"]
    one = CliRunner().invoke(app, ["config", "check", str(file), "--as", "robot"])
    assert "is valid: 1 remote(s), 2 route(s)." in one.stdout
    other = CliRunner().invoke(app, ["config", "check", str(file), "--as", "robt"])
    assert other.exit_code == 2
    assert "robot" in other.stderr
