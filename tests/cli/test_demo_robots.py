"""``ropeway demo-robots``: five robots that are alike in one picture."""

from __future__ import annotations

import json
from pathlib import Path

from ropeway.cli.demo_robots.drawing import draw
from ropeway.cli.demo_robots.scene import ROBOTS, Picture, _transform
from tests.cli.conftest import Ropeway


def test_all_are_there(ropeway: Ropeway, tmp_path: Path) -> None:
    """Every robot is seen under its own name, with what is mounted on it, and is drawn."""
    output = tmp_path / "robots.png"
    done = ropeway("demo-robots", "--json", "--for", "1", "--output", str(output))
    assert done.returncode == 0, done.stdout + done.stderr
    told = json.loads(done.stdout)
    assert told["ok"]
    assert [one["robot"] for one in told["robots"]] == list(ROBOTS)
    assert all(one["static_frames"] == ["camera"] for one in told["robots"])
    assert output.read_bytes().startswith(b"\x89PNG")


def test_frames_of_strangers(tmp_path: Path) -> None:
    """Frames without the name of a robot, and what is mounted on another's, are left out."""
    picture = Picture()
    picture.moved({"transforms": [_transform("map", "base_link", (1.0, 2.0, 0.5))]})
    picture.holds({"transforms": [_transform("robot2/base_link", "robot1/camera", (1.0, 2.0, 0.5))]})
    assert not any(picture.tracks.values())
    assert not any(picture.mounted.values())
    picture.moved({"transforms": [_transform("map", "robot1/base_link", (1.0, 2.0, 0.5))]})
    ((x, y, heading),) = picture.tracks["robot1"]
    assert (x, y, round(heading, 6)) == (1.0, 2.0, 0.5)
    assert draw(picture, tmp_path / "x.png")
