"""The command as a whole: start, help, errors and exit codes."""

from __future__ import annotations

import subprocess
import sys

import pytest
import typer
from typer.testing import CliRunner

from ropeway import __version__
from ropeway.aio import BaseExceptionGroup, ExceptionGroup
from ropeway.cli import VERBS, app
from ropeway.cli.console import fail, reported
from ropeway.cli.loop import run
from ropeway.errors import ConfigError, GraphUnavailable


def test_version() -> None:
    """``--version`` prints the version of the package."""
    result = CliRunner().invoke(app, ["--version"])
    assert (result.exit_code, result.stdout) == (0, f"ropeway {__version__}\n")


def test_help_lists_every_verb() -> None:
    """The help names every verb, and every verb has its own help."""
    result = CliRunner().invoke(app, ["--help"])
    assert result.exit_code == 0
    for verb in VERBS:
        assert verb in result.stdout
        assert CliRunner().invoke(app, [verb, "--help"]).exit_code == 0


@pytest.mark.parametrize("start", [("-m", "ropeway"), ("-c", "from ropeway.cli import main; main()")])
def test_its_name(start: tuple[str, str]) -> None:
    """The command calls itself by its name, also where a script of another name starts it."""
    told = subprocess.run([sys.executable, *start, "topic", "--help"], capture_output=True, text=True, check=True)
    assert "Usage: ropeway topic " in told.stdout


@pytest.mark.parametrize("verb", ["list", "type", "info", "find", "echo", "hz", "bw", "delay", "pub"])
def test_help_of_topic_verbs(verb: str) -> None:
    """Every verb of ``topic`` has its help and a way to choose the network."""
    result = CliRunner().invoke(app, ["topic", verb, "--help"], env={"COLUMNS": "200"})
    assert result.exit_code == 0
    assert "--graph" in result.stdout
    assert "--json" in result.stdout


@pytest.mark.parametrize("verb", [("topic", "list"), ("config", "check"), ("run",)])
def test_flags_have_no_type(verb: tuple[str, ...]) -> None:
    """The help shows a flag as what it is: without a value."""
    told = CliRunner().invoke(app, [*verb, "--help"]).output
    assert "--json" in told
    assert "<bool>" not in told


def test_unknown_verb_is_a_usage_error() -> None:
    """A verb that is not there ends with status 2."""
    assert CliRunner().invoke(app, ["fly"]).exit_code == 2
    assert CliRunner().invoke(app, ["topic", "fly"]).exit_code == 2


def test_start_loads_no_network() -> None:
    """The top of the command imports neither numpy, DDS and pydantic nor what reads options: it starts at once."""
    heavy = "('numpy', 'cyclonedds', 'pydantic', 'rosbags', 'typer')"
    code = f"import sys, ropeway.cli; print([m for m in {heavy} if m in sys.modules])"
    result = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert result.stdout.strip() == "[]"


@pytest.mark.parametrize(
    ("error", "code"),
    [
        (GraphUnavailable("dds:0", "is away"), 1),
        (ConfigError([("a", "b")], "f"), 2),
        (BaseExceptionGroup("", [ExceptionGroup("", [GraphUnavailable("dds:0", "is away")])]), 1),
        (KeyboardInterrupt(), 130),
    ],
)
def test_errors_become_sentences(error: BaseException, code: int, capsys: pytest.CaptureFixture[str]) -> None:
    """Our errors, alone or in groups, end with a sentence on stderr and a code, without a traceback."""
    with pytest.raises(typer.Exit) as ended, reported():
        raise error
    assert ended.value.exit_code == code
    said = capsys.readouterr()
    assert said.out == ""
    assert said.err in ("ropeway: dds:0: is away\n", "ropeway: f: a: b\n", "")


def test_faults_of_ours_are_not_hidden() -> None:
    """An error that is none of Ropeway's keeps its traceback."""
    with pytest.raises(ExceptionGroup), reported():
        raise ExceptionGroup("", [ZeroDivisionError()])
    with pytest.raises(ZeroDivisionError), reported():
        raise ZeroDivisionError


def test_fail_says_why(capsys: pytest.CaptureFixture[str]) -> None:
    """``fail`` prints one sentence and ends with its code."""
    with pytest.raises(typer.Exit) as ended:
        fail("it is broken", 2)
    assert ended.value.exit_code == 2
    assert capsys.readouterr().err == "ropeway: it is broken\n"


def test_run_gives_the_result_of_a_coroutine() -> None:
    """A verb's coroutine runs to its result."""

    async def answer() -> int:
        return 42

    assert run(answer()) == 42
