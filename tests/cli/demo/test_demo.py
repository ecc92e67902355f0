"""The demo: its parts, its figures, and the whole of it."""

from __future__ import annotations

import asyncio
import json
import os
from pathlib import Path

import pytest
from rich.console import Console

from ropeway.cli.demo.flow import Tally
from ropeway.cli.demo.gateways import GatewayProcess, configurations, figures, free_port
from ropeway.cli.demo.scene import recorded_parts, synthetic_parts
from ropeway.cli.demo.table import brief, live_table, summary_table
from ropeway.cli.session import OpenGraph
from ropeway.gateway.config.config import parse
from ropeway.graph.base import Sample
from ropeway.types import TypeRegistry
from tests.cli.conftest import Ropeway
from tests.support.recordings import RECORDINGS
from tests.support.until import until

SECOND = 10**9


def flow(side: str = "robot") -> Tally:
    """A flow whose payloads are their own stamps, in nanoseconds as text."""
    return Tally("/a", "a/msg/B", side, lambda payload: int(payload) if payload else None)


def arrival(stamp_ns: int, payload: bytes) -> Sample:
    """A message that arrived at this time."""
    return Sample(payload, "a/msg/B", stamp_ns, b"", 1)


def test_flow_counts_rate_delay_and_bytes() -> None:
    """A flow knows its last second and its whole."""
    counted = flow()
    counted.on_sent(5)
    for n in range(4):
        counted.on_batch([arrival(SECOND + n * SECOND // 2, str(SECOND + n * SECOND // 2 - 2_000_000).encode())])
    recent = counted.recent(SECOND + 3 * SECOND // 2)
    assert (recent.rate_hz, recent.delay_ms) == (3.0, 2.0)
    assert recent.bandwidth_bps > 0
    total = counted.summary()
    assert (total["sent"], total["arrived"], total["rate_hz"]) == (5, 4, 2.0)
    assert (total["delay_ms_p50"], total["delay_ms_p99"]) == (2.0, 2.0)
    assert counted.recent(100 * SECOND).rate_hz == 0


def test_a_silent_flow_has_figures_too() -> None:
    """Where nothing arrived, nothing is divided by zero."""
    assert flow().summary()["rate_hz"] == 0.0
    assert flow().summary()["delay_ms_p50"] is None
    assert flow().recent().delay_ms is None


def test_configurations_are_valid(registry: TypeRegistry) -> None:
    """Both gateways get configurations without a fault; the robot dials the cloud."""
    configs = configurations(synthetic_parts(registry), "dds:71", "dds:72", 9099)
    robot, cloud = parse(configs["robot"]), parse(configs["cloud"])
    assert cloud.gateway.listen == ("ws://127.0.0.1:9099",)
    assert robot.gateway.listen == ()
    assert [(r.operation, r.name, r.options.delivery.priority) for r in robot.routes()] == [
        ("publish", "/camera/image", 4),
        ("publish", "/odom", 4),
        ("subscribe", "/annotated/image", 4),
        ("subscribe", "/cmd_vel", 0),
    ]


async def test_every_synthetic_part_sends_valid_messages(
    pair: tuple[OpenGraph, OpenGraph], registry: TypeRegistry
) -> None:
    """Each sender publishes messages of its type with stamps of now, and counts them."""
    here, there = pair
    for part in synthetic_parts(registry):
        counted = Tally(part.topic, part.type, part.side, registry.codec(part.type).header_stamp_ns)
        got: list[Sample] = []
        await here.graph.create_subscription(part.topic, part.type, None, got.extend)
        sending = asyncio.create_task(part.send(there.graph, counted.on_sent))
        await until(lambda counted=counted, got=got: counted.sent >= 3 and len(got) >= 2)
        sending.cancel()
        with pytest.raises(asyncio.CancelledError):
            await sending
        counted.on_batch(got)
        assert registry.codec(part.type).decode(got[0].payload)
        assert 0 <= counted.delays_ms[0] < 1000
    image = registry.codec("sensor_msgs/msg/Image").decode((await _one_picture(pair, registry)).payload)
    assert (image["width"], image["height"], image["encoding"], len(image["data"])) == (424, 240, "rgb8", 424 * 240 * 3)


async def _one_picture(pair: tuple[OpenGraph, OpenGraph], registry: TypeRegistry) -> Sample:
    here, there = pair
    part = synthetic_parts(registry)[0]
    got: list[Sample] = []
    await here.graph.create_subscription(part.topic, part.type, None, got.extend)
    sending = asyncio.create_task(part.send(there.graph, lambda count: None))
    await until(lambda: bool(got))
    sending.cancel()
    await asyncio.gather(sending, return_exceptions=True)
    return got[0]


def test_figures_join_what_both_gateways_tell(tmp_path: Path) -> None:
    """Drops of both are added up, and the sender's encoding is shown."""
    route = {"state": "active", "encoding": "auto", "drops": {"too old": 2}}
    robot = {"routes": [{"name": "/a", **route}, {"name": "/b", **route, "encoding": "zstd"}]}
    topics = [{"name": "/a", "drops": {"too old": 1}, "encoding": "rawzip"}, {"name": "/c", "drops": {}}]
    cloud = {"sessions": [{"topics": topics}]}
    process = None
    told = figures(
        {
            "robot": GatewayProcess("robot", process, tmp_path, robot),  # type: ignore[arg-type]
            "cloud": GatewayProcess("cloud", process, tmp_path, cloud),  # type: ignore[arg-type]
        }
    )
    assert told["/a"] == {"state": "active", "encoding": "rawzip", "drops": {"too old": 3}}
    assert told["/b"] == {"state": "active", "encoding": "zstd", "drops": {"too old": 2}}
    assert "/c" not in told


def test_tables_fit_a_terminal() -> None:
    """Both tables show each route on one line of 80 columns."""
    flows = [flow(), flow("cloud")]
    flows[0].on_batch([arrival(SECOND, b"1")])
    console = Console(width=80, record=True, file=open(os.devnull, "w"))  # noqa: SIM115, PTH123
    console.print(live_table(flows, {"/a": {"encoding": "zstd", "drops": {"late": 4}}}, 3.0))
    console.print(summary_table(flows, {}))
    console.file.close()
    lines = console.export_text().splitlines()
    assert sum("→ cloud" in line for line in lines) == 2
    assert sum("→ robot" in line for line in lines) == 2
    assert any("zstd" in line and " 4 " in line for line in lines)
    assert brief(flows, 5.0) == "  5 s: /a 0 Hz - ms, /a 0 Hz - ms"


def test_free_ports_are_free() -> None:
    """A free port is a port of TCP."""
    assert 1024 <= free_port() < 65536


@pytest.mark.data
@pytest.mark.skipif(not RECORDINGS.exists(), reason="needs recorded sensor data: name its directory in ROPEWAY_DATA")
def test_parts_of_a_recording() -> None:
    """The cameras and the odometry of a recording are used, and the rest is made up."""
    parts = recorded_parts(TypeRegistry(), RECORDINGS / "dev.mcap")
    assert [(part.topic, part.side) for part in parts] == [
        ("/camera/color/image_raw", "robot"),
        ("/odom", "robot"),
        ("/camera/depth/image_rect_raw", "cloud"),
        ("/cmd_vel", "cloud"),
    ]
    scans = recorded_parts(TypeRegistry(), RECORDINGS / "bags/scan_tools_demo.bag")
    assert [(part.topic, part.side) for part in scans] == [
        ("/scan", "robot"),
        ("/odom", "robot"),
        ("/annotated/scan", "cloud"),
        ("/cmd_vel", "cloud"),
    ]


@pytest.mark.slow
def test_the_whole_demo(ropeway: Ropeway) -> None:
    """Two networks, two gateways: messages arrive on every route and the status is 0."""
    domains = (str(150 + os.getpid() % 40), str(190 + os.getpid() % 40))
    result = ropeway("demo", "--for", "2", "--json", "--domains", *domains, timeout_s=120)
    assert result.returncode == 0, result.stderr
    told = json.loads(result.stdout)
    assert told["ok"]
    assert {row["topic"] for row in told["routes"]} == {"/camera/image", "/odom", "/annotated/image", "/cmd_vel"}
    for row in told["routes"]:
        assert 0 < row["arrived"] <= row["sent"]
        assert 0 < row["delay_ms_p50"] < 500


@pytest.mark.slow
def test_progress(ropeway: Ropeway) -> None:
    """Without a terminal the demo says what it does, from its start to a first line of figures and the summary."""
    domains = (str(150 + os.getpid() % 40), str(190 + os.getpid() % 40))
    result = ropeway("demo", "--for", "3", "--domains", *domains, timeout_s=120)
    assert result.returncode == 0, result.stderr
    starting, connected, figures, *_ = result.stderr.splitlines()
    assert starting.startswith(f"Starting two gateways, on the DDS domains {domains[0]} ")
    assert connected.startswith("They are connected")
    assert " Hz " in figures
    assert "Messages arrived on every route." in result.stdout
