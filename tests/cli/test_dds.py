"""Verbs as a user runs them: processes on a DDS network of this machine."""

from __future__ import annotations

import itertools
import json
import signal
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
from mcap.writer import Writer as McapWriter
from typer.testing import CliRunner

from ropeway.cli import app
from ropeway.types import TypeRegistry
from tests.cli.conftest import Ropeway
from tests.support.until import PATIENCE_S

Start = Callable[..., subprocess.Popen[str]]
POINT = "geometry_msgs/msg/PointStamped"


@pytest.fixture
def talker(background: Start) -> subprocess.Popen[str]:
    """A publisher with stamps of now, at 50 Hz, that has begun."""
    values = "{header: auto, point: {x: 1.5}}"
    process = background("topic", "pub", "/points", POINT, values, "-r", "50", "-p", "10")
    assert process.stdout is not None
    assert process.stdout.readline() == "publisher: beginning loop\n"
    return process


def test_looking_at_a_topic(ropeway: Ropeway, talker: subprocess.Popen[str]) -> None:
    """A topic is listed, described and printed."""
    assert ropeway("topic", "list", "-t").stdout == f"/points [{POINT}]\n"
    (listed,) = json.loads(ropeway("topic", "list", "--json").stdout)
    assert listed == {"name": "/points", "types": [POINT], "publishers": 1, "subscriptions": 0}
    info = ropeway("topic", "info", "/points", "-v")
    assert info.stdout.startswith(f"Type: {POINT}\n\nPublisher count: 1\n\nNode name: ropeway_")
    assert "\nTopic type hash: RIHS01_" in info.stdout
    echoed = ropeway("topic", "echo", "points", "--once", "--field", "point")
    assert (echoed.stdout, echoed.returncode) == ("x: 1.5\ny: 0.0\nz: 0.0\n---\n", 0)
    assert talker.poll() is None


def test_meters(background: Start, talker: subprocess.Popen[str]) -> None:
    """Rate, bandwidth and delay are printed each second until Ctrl-C, which ends them quietly with 130."""
    wanted: dict[str, Callable[[dict[str, float]], bool]] = {
        "hz": lambda told: told["rate_hz"] == pytest.approx(50, rel=0.2),
        "bw": lambda told: told["bandwidth_Bps"] == pytest.approx(2400, rel=0.3),
        "delay": lambda told: 0 < told["mean_s"] < 0.1,
    }
    meters = {verb: background("topic", verb, "/points", "--json") for verb in wanted}
    told: list[dict[str, Any]] = []
    for verb, meter in meters.items():
        assert meter.stdout is not None
        for line in itertools.islice(meter.stdout, 30):  # the machine may have no time for 50 Hz in the first seconds
            told.append(json.loads(line))
            if wanted[verb](told[-1]):
                break
        else:
            pytest.fail(f"{verb} told {told}")
        meter.send_signal(signal.SIGINT)
        _, err = meter.communicate(timeout=PATIENCE_S)
        assert (meter.returncode, err) == (130, "")
    assert {line["topic"] for line in told} == {"/points"}
    sizes = [line["mean_bytes"] for line in told if "mean_bytes" in line]
    assert sizes
    assert sizes == [pytest.approx(48, abs=4)] * len(sizes)
    assert talker.poll() is None


def test_publishing_once_waits_for_a_reader(background: Start, ropeway: Ropeway) -> None:
    """``pub --once`` arrives at a reader that is there, and says what it sends."""
    reader = background("topic", "echo", "/chatter", "std_msgs/msg/String", "--once")
    sent = ropeway("topic", "pub", "--once", "/chatter", "std_msgs/String", "{data: hi}")
    assert sent.returncode == 0
    assert "publishing #1: std_msgs.msg.String(data='hi')\n" in sent.stdout
    out, _ = reader.communicate(timeout=PATIENCE_S)
    assert (out, reader.returncode) == ("data: hi\n---\n", 0)


@pytest.mark.parametrize(
    ("arguments", "code", "words"),
    [
        (("topic", "echo", "/nothing", "--spin-time", "0.2"), 1, "Could not determine the type for /nothing"),
        (("topic", "info", "/nothing", "--spin-time", "0.2"), 1, "Unknown topic '/nothing'"),
        (
            ("topic", "echo", "/x", "std_msgs/msg/String", "--once", "--timeout", "0.2"),
            1,
            "no message on /x within 0.2 s",
        ),
        (("topic", "echo", "a b"), 2, "is not a valid name"),
        (("topic", "echo", "/x", "std_msgs/msg/Strin", "--once"), 1, "did you mean std_msgs/msg/String?"),
        (("topic", "echo", "/x", "--csv", "--raw"), 2, "exclude each other"),
        (("topic", "pub", "/x", "std_msgs/msg/String", "{dta: 1}", "--once"), 1, "dta"),
        (("topic", "pub", "/x", "std_msgs/msg/String", "{data: ", "--once"), 2, "the values cannot be read"),
        (("topic", "pub", "/x", "std_msgs/msg/String", "--once", "--times", "3"), 2, "exclude each other"),
        (("topic", "list", "--graph", "dsd:0"), 1, "dsd:0"),
        (("topic", "list", "--graph", "ws://127.0.0.1:1"), 1, "ws://127.0.0.1:1"),
        (("topic", "hz"), 2, "Missing argument"),
        (("play", "/nothing.mcap"), 1, "/nothing.mcap: there is no such file"),
        (("run", "/nothing.json", "--log-level", "loud"), 2, "is not a log level"),
    ],
)
def test_mistakes_become_sentences(
    environment: dict[str, str], arguments: tuple[str, ...], code: int, words: str
) -> None:
    """A mistake gives one sentence on stderr, nothing on stdout and the code that fits; never a traceback."""
    result = CliRunner().invoke(app, arguments, env={**environment, "COLUMNS": "200"})
    assert isinstance(result.exception, SystemExit)
    assert result.exit_code == code, result.stderr
    assert words in result.stderr
    assert "publishing" not in result.stdout


def test_mistakes_in_a_process(ropeway: Ropeway) -> None:
    """The exit status of the process is that of the mistake."""
    result = ropeway("topic", "echo", "/x", "--csv", "--raw")
    assert (result.returncode, result.stdout) == (2, "")
    assert result.stderr == "ropeway: --csv and --raw exclude each other; give one\n"


def test_a_closed_pipe_ends_quietly(environment: dict[str, str], talker: subprocess.Popen[str]) -> None:
    """``ropeway topic echo … | head`` ends without a word when head has enough."""
    command = f"{sys.executable} -m ropeway topic echo /points | head -n 1"
    result = subprocess.run(
        ["sh", "-c", command], capture_output=True, text=True, timeout=PATIENCE_S, env=environment, check=False
    )
    assert (result.stdout, result.stderr) == ("header:\n", "")


def test_playing_a_recording(ropeway: Ropeway, background: Start, tmp_path: Path) -> None:
    """A recording is played to a reader, restamped, and summed up."""
    registry = TypeRegistry()
    path = tmp_path / "a.mcap"
    with path.open("wb") as file:
        writer = McapWriter(file)
        writer.start("ros2")
        schema = writer.register_schema(POINT, "ros2msg", registry.full_text(POINT).encode())
        channel = writer.register_channel("/recorded", "cdr", schema)
        for n in range(30):
            payload = registry.codec(POINT).encode({"header": {"stamp": {"sec": n}}, "point": {"x": float(n)}})
            writer.add_message(channel, n * 20_000_000, payload, n)
        writer.finish()
    reader = background("topic", "echo", "/recorded", POINT, "--csv", "--timeout", "40")
    result = ropeway("play", str(path), "--restamp", "--json", "--topics", "recorded", "--wait", "10")
    assert result.returncode == 0, result.stderr
    told = json.loads(result.stdout)
    assert (told["messages"], told["topics"]) == (30, {"/recorded": 30})
    assert reader.stdout is not None
    lines = [reader.stdout.readline().split(",") for _ in range(30)]
    assert [float(line[3]) for line in lines] == [float(n) for n in range(30)]
    assert all(int(line[0]) > 1_000_000_000 for line in lines)
    absent = ropeway("play", str(path), "--topics", "/other")
    assert absent.returncode == 1
    assert "has no topic /other; it has /recorded" in absent.stderr
