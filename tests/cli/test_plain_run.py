"""``ropeway run`` without what reads the options of all verbs: it does the same, or leaves it to the command line."""

from __future__ import annotations

import inspect
import json
import subprocess
import sys
from dataclasses import fields
from pathlib import Path
from typing import Any

import pytest
import typer.main

from ropeway.cli import gateway_run, run
from ropeway.cli.gateway_run import RunOrder
from ropeway.cli.plain_run import plain_order

_FILE = Path("robot.yaml")


def ordered(monkeypatch: pytest.MonkeyPatch, args: list[str]) -> RunOrder:
    """Return what the command line makes of the same words."""
    orders: list[RunOrder] = []
    monkeypatch.setattr(run, "run_gateway", orders.append)
    typer.main.get_command(run.app)(args, standalone_mode=False)
    (order,) = orders
    return order


@pytest.mark.parametrize(
    "args",
    [
        ["robot.yaml"],
        ["robot.yaml", "--quiet", "--for", "3"],
        ["-q", "--for=0.5", "robot.yaml", "--log-level", "debug", "--as=robot"],
        ["--json", "--period", "0.05", "robot.yaml", "--as", "robot", "--watch"],
        ["robot.yaml", "--live"],
        ["robot.yaml", "--live", "--no-live"],
        ["robot.yaml", "--log-level", "loud"],
        ["robot.yaml", "--for", "inf"],
    ],
    ids=" ".join,
)
def test_it_is_what_the_command_line_makes(monkeypatch: pytest.MonkeyPatch, args: list[str]) -> None:
    """Plain options mean what they mean to the command line."""
    assert plain_order(args) == ordered(monkeypatch, args)


@pytest.mark.parametrize(
    "args",
    [
        [],
        ["--help"],
        ["a.yaml", "b.yaml"],
        ["robot.yaml", "--fro", "3"],
        ["robot.yaml", "--for"],
        ["robot.yaml", "--for", "long"],
        ["robot.yaml", "--for", "-1"],
        ["robot.yaml", "--for", "nan"],
        ["robot.yaml", "--period", "0.01"],
        ["robot.yaml", "--quiet=yes"],
        ["-qh", "robot.yaml"],
        ["--", "robot.yaml"],
    ],
    ids=" ".join,
)
def test_the_command_line_explains(args: list[str]) -> None:
    """What is more than one file and plain options is left to the command line."""
    assert plain_order(args) is None


def test_a_shell_that_completes(monkeypatch: pytest.MonkeyPatch) -> None:
    """A shell that asks what may follow is answered by the command line."""
    monkeypatch.setenv("_ROPEWAY_COMPLETE", "complete_bash")
    assert plain_order(["robot.yaml"]) is None


def test_every_option_is_ordered() -> None:
    """An option of the verb is a field of the order, with the same default."""
    parameters = inspect.signature(run.run_command).parameters
    assert list(parameters) == [field.name for field in fields(RunOrder)]
    order = RunOrder(_FILE)
    assert {name: one.default for name, one in parameters.items() if name != "config"} == {
        name: getattr(order, name) for name in parameters if name != "config"
    }


def ran(tmp_path: Path, configuration: dict[str, Any], *args: str) -> subprocess.CompletedProcess[str]:
    """Run a gateway, and tell what of some modules it has loaded."""
    path = tmp_path / "robot.json"
    path.write_text(json.dumps(configuration))
    program = f"""
import sys
from ropeway.cli import main
sys.argv[1:] = ["run", {str(path)!r}, *{list(args)!r}]
try:
    main()
finally:
    print([name for name in ("typer", "rich", "ropeway.planning", "ropeway.gateway.gateway") if name in sys.modules])
"""
    return subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, check=False, timeout=240)


def test_a_gateway_runs_without_it(tmp_path: Path) -> None:
    """A gateway that is run with plain options loads nothing of the command line."""
    done = ran(tmp_path, {"gateway": {"graphs": ["memory:plain"], "listen": []}}, "--quiet", "--for", "0.1")
    assert (done.returncode, done.stderr) == (0, "")
    assert done.stdout.splitlines()[-1:] == ["['ropeway.gateway.gateway']"]


def test_errors_are_sentences(tmp_path: Path) -> None:
    """A wrong configuration ends with status 2, and a sentence for each fault."""
    done = ran(tmp_path, {"gateway": {"graphs": ["memory:plain"], "listne": []}}, "--quiet")
    assert done.returncode == 2
    assert "listne" in done.stderr
    assert "Traceback" not in done.stderr


def test_a_level_that_is_none() -> None:
    """A level of the log that is none is a mistake of the command line."""
    with pytest.raises(typer.Exit) as ended:
        gateway_run.run_gateway(RunOrder(_FILE, log_level="loud"))
    assert ended.value.exit_code == 2
