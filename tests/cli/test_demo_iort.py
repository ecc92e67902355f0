"""``ropeway demo-iort``: one command to robots that differ."""

from __future__ import annotations

import json
import math
from pathlib import Path

import pytest

from ropeway.cli.demo_iort.robots import Track, ros1_missing
from ropeway.cli.demo_iort.tracks import draw, summary
from tests.cli.conftest import Ropeway


@pytest.mark.slow
@pytest.mark.timeout(300)
def test_three_robots(ropeway: Ropeway, tmp_path: Path) -> None:
    """A robot of ROS 2, one of ROS 1 (where it is installed) and Alice do what one node says, and it is drawn."""
    output = tmp_path / "tracks.png"
    done = ropeway("demo-iort", "--json", "--output", str(output), "--domain", "74", timeout_s=200)
    assert done.returncode == 0, done.stdout + done.stderr
    told = json.loads(done.stdout)
    names = ["ROS 2", "Alice"] if ros1_missing() else ["ROS 2", "ROS 1", "Alice"]
    assert [row["robot"] for row in told["robots"]] == names
    for row in told["robots"]:
        assert row["metres"] == pytest.approx(1.5, abs=0.3)
        assert row["turns_deg"] == [pytest.approx(45, abs=15), pytest.approx(180, abs=20)]
    assert output.read_bytes().startswith(b"\x89PNG")


def test_summary(tmp_path: Path) -> None:
    """Turns and metres are found in a track; one that did something else is not taken for right."""
    track: Track = [(i * 0.02, min(i, 100) * 0.01, 0.0, 0.0) for i in range(120)]
    track += [(t + 2.4, 1.0, 0.0, h) for t, h in ((i * 0.02, math.radians(90) * i / 50) for i in range(51))]
    found = summary("x", track)
    assert found["metres"] == pytest.approx(1.0)
    assert found["turns_deg"] == [pytest.approx(90)]
    assert not found["ok"]
    assert draw({"x": track, "y": []}, tmp_path / "x.png")
