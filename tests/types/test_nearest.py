"""ropeway.types.nearest: what a misspelt type may mean."""

from __future__ import annotations

import pytest

from ropeway.types.nearest import Nearest

NAMES = ["geometry_msgs/msg/Twist", "sensor_msgs/msg/Image", "sensor_msgs/msg/Imu", "std_msgs/msg/String"]


@pytest.mark.parametrize(
    ("given", "meant"),
    [
        ("sensor_msgs/msg/Imge", "sensor_msgs/msg/Image"),
        ("sensors_msgs/msg/Image", "sensor_msgs/msg/Image"),
        ("std_msg/msg/String", "std_msgs/msg/String"),
        ("std_msgs/msg/String", ""),
        ("my_msgs/msg/Wheel", ""),
        ("sensor_msgs/msg/PointCloudOfManyPoints", ""),
    ],
)
def test_a_misspelt_name(given: str, meant: str) -> None:
    """A name with another end in its package, or the same end in another, may mean one that is near; itself never."""
    assert Nearest(lambda: NAMES).to(given) == meant


def test_names_that_come_later() -> None:
    """Names that are known later count once the old ones are forgotten."""
    names = list(NAMES)
    nearest = Nearest(lambda: names)
    assert nearest.to("my_msgs/msg/Wheeel") == ""
    names.append("my_msgs/msg/Wheel")
    nearest.forget()
    assert nearest.to("my_msgs/msg/Wheeel") == "my_msgs/msg/Wheel"


def test_a_flood_of_misspelt_names() -> None:
    """Of a flood of misspelt names only the first are looked up, and again some when time has passed."""
    now = 0.0
    nearest = Nearest(lambda: NAMES, clock=lambda: now)
    found = [nearest.to("std_msgs/msg/Strin") for _ in range(1000)]
    assert sum(map(bool, found)) == 64
    now = 1.0
    found = [nearest.to("std_msgs/msg/Strin") for _ in range(1000)]
    assert sum(map(bool, found)) == 8
