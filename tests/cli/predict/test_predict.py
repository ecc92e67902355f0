"""``ropeway predict``."""

from __future__ import annotations

import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import pytest
from typer.testing import CliRunner, Result

from ropeway.cli import app
from ropeway.cli.predict.sources import measure_topics
from ropeway.cli.session import OpenGraph
from ropeway.graph.base import Sample
from ropeway.planning.measured import TopicSampler
from tests.support.recordings import RECORDINGS
from tests.support.until import until

PAPER = ("-t", "/color,bytes=305280,hz=60,ratio=2.101", "-t", "/depth,bytes=203520,hz=60,ratio=2.101")


def predict(*arguments: str) -> Result:
    """Run the verb."""
    return CliRunner().invoke(app, ["predict", *arguments])


def test_topics_of_the_command_line() -> None:
    """The paper's case in one command; what will not arrive whole is exit status 1."""
    result = predict("--mbit", "100", "--readers", "3", "--json", *PAPER)
    assert result.exit_code == 1
    rows = json.loads(result.stdout)["predictions"]
    rates = {row["encoding"]: row["rate_hz"] for row in rows if row["topic"] == "/color"}
    assert rates == pytest.approx({"dds": 8.19, "gateway": 51.6, "zip": 51.6}, abs=0.05)


def test_what_fits_is_success() -> None:
    """A link that carries everything is exit status 0, and the table has a row per topic."""
    result = predict("--mbit", "1000", *PAPER)
    assert result.exit_code == 0
    assert "robot → cloud, 1000 Mbit/s" in result.stdout
    assert "/color" in result.stdout
    assert "/depth" in result.stdout


FLEET = """
gateways:
  cloud: {host: 10.0.0.1, gateway: {listen: ["ws://0.0.0.0:9090"], insecure: true}}
  robot1: &robot
    remotes:
      - address: ws://10.0.0.1:9090
        link: {mbit: 20}
        publish: [{name: /color, type: sensor_msgs/Image, expected: {bytes: 100000, hz: 10}}]
  robot2: *robot
"""


@pytest.mark.parametrize(("more", "ways"), [((), {"robot1", "robot2"}), (("--as", "robot2"), {"robot2"})])
def test_a_document_for_many_gateways(tmp_path: Path, more: tuple[str, ...], ways: set[str]) -> None:
    """All gateways of a document are predicted together, each link by the names of those that it joins, or one."""
    file = tmp_path / "fleet.yaml"
    file.write_text(FLEET)
    result = predict(str(file), "--json", *more)
    rows = json.loads(result.stdout)["predictions"]
    assert {row["way"]["from"] for row in rows} == ways
    assert {row["way"]["to"] for row in rows} == ({"cloud"} if not more else {"ws://10.0.0.1:9090"})
    assert result.exit_code == 0


def test_a_plan(tmp_path: Path) -> None:
    """A plan in a file says which hosts publish and read what over which links."""
    file = tmp_path / "plan.yaml"
    file.write_text(
        "links: [{between: [robot, cloud], mbit: 100, delay_ms: 10}]\n"
        "topics: [{name: /color, bytes: 305280, hz: 15, publishers: {robot: 1}, readers: {cloud: 3}}]\n"
    )
    result = predict(str(file), "--encoding", "dds")
    assert result.exit_code == 1
    assert "13.6" in result.stdout  # 100 of 110 Mbit/s


def test_a_configuration(tmp_path: Path) -> None:
    """A configuration says what crosses; a topic of which nothing is known is named."""
    known = {"name": "/a", "type": "std_msgs/String", "expected": {"bytes": 1000, "hz": 10}}
    remote: dict[str, Any] = {"address": "ws://cloud", "title": "cloud", "link": {"mbit": 1}}
    remote["publish"] = [known, {"name": "/b", "type": "std_msgs/String"}]
    file = tmp_path / "robot.json"
    file.write_text(json.dumps({"gateway": {"name": "robot"}, "remotes": [remote]}))
    result = predict(str(file))
    assert result.exit_code == 0
    assert "remotes[0].publish[1] is left out" in result.stderr
    assert "robot → cloud" in result.stdout


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        ((), "--mbit"),
        (("--mbit", "100"), "--topic"),
        (("--mbit", "100", "-t", "/a,byte=5"), "did you mean"),
        (("--mbit", "100", "-t", "/a,bytes=many"), "takes a number"),
        (("--mbit", "100", "-t", "/a,bytes=5"), "/a is left out"),
        (("--mbit", "100", "--hosts", "robot", "-t", "/a,bytes=5,hz=5"), "two names"),
        (("--mbit", "100", "-t", "/a,bytes=5,hz=5", "--encoding", "zap"), "expected one of"),
    ],
)
def test_wrong_command_lines(arguments: tuple[str, ...], said: str) -> None:
    """A wrong command line is exit status 2 and says what to write."""
    result = predict(*arguments)
    assert result.exit_code == 2
    assert said in result.stderr


async def test_measures_a_network(pair: tuple[OpenGraph, OpenGraph]) -> None:
    """Topics of a network are measured for a while: size, rate and compression."""
    here, there = pair
    publisher = await there.graph.create_publisher("/a", "std_msgs/msg/String")
    codec = there.registry.codec("std_msgs/msg/String")
    payload = codec.encode({"data": "tick" * 100})

    async def measuring(samplers: Mapping[str, TopicSampler]) -> None:
        await until(lambda: bool(publisher.subscribers))
        for number in range(20):
            publisher.publish(Sample(payload, "std_msgs/msg/String", 1 + number, bytes(16), number))
        await until(lambda: samplers["/a"].count == 20)

    topic = (await measure_topics(here, ["/a"], measuring))["/a"].topic(codec, {"robot": 1}, {"cloud": 1})
    assert topic is not None
    assert topic.size_bytes == len(payload)
    assert topic.ratios["zip"] > 2


@pytest.mark.data
@pytest.mark.skipif(not RECORDINGS.exists(), reason="needs recorded sensor data: name its directory in ROPEWAY_DATA")
def test_measures_a_recording(tmp_path: Path) -> None:
    """A recording tells sizes, rates and compression; the picture is drawn."""
    recording = sorted(RECORDINGS.glob("*.mcap"))[0]
    pytest.importorskip("matplotlib")
    picture = tmp_path / "rates.png"
    result = predict("--mbit", "100", "--bag", str(recording), "--seconds", "1", "--plot", str(picture), "--json")
    rows = json.loads(result.stdout)["predictions"]
    assert {row["encoding"] for row in rows} >= {"dds", "gateway", "none", "zstd"}
    assert picture.read_bytes().startswith(b"\x89PNG")
