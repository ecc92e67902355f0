"""What viewers may see and do beside their roles."""

from __future__ import annotations

import pytest

from ropeway.networks.foxglove.settings import FoxgloveSettings, patterns


def test_all_is_shown() -> None:
    """Without patterns everything is shown but what is hidden, and nothing is read as best effort."""
    settings = FoxgloveSettings()
    assert settings.shows_topic("/a/b")
    assert settings.shows_service("/add")
    assert settings.shows_param("/n.a")
    assert settings.takes_topic("/cmd_vel")
    assert not settings.shows_topic("/a/_action/status")
    assert not settings.shows_service("/_hidden")
    assert not settings.reads_best_effort("/a")
    assert FoxgloveSettings(include_hidden=True).shows_topic("/a/_action/status")


def test_a_pattern_matches_whole_names() -> None:
    """A pattern names what it matches whole, and each list counts for its own kind."""
    settings = FoxgloveSettings(topics=patterns(("/cam", "/imu.*")), params=patterns((r"/n\..*",)))
    assert settings.shows_topic("/cam")
    assert settings.shows_topic("/imu/data")
    assert not settings.shows_topic("/camera")
    assert settings.shows_service("/camera")
    assert settings.shows_param("/n.a")
    assert not settings.shows_param("/other.a")


@pytest.mark.parametrize(("offered", "kept"), [(0, 2), (1, 2), (5, 5), (1000, 25)])
def test_depth(offered: int, kept: int) -> None:
    """As many messages wait as the publishers keep, within the two bounds."""
    assert FoxgloveSettings(min_depth=2, max_depth=25).depth(offered) == kept


@pytest.mark.parametrize(
    ("uri", "served"),
    [
        ("package://arm/meshes/link.STL", False),
        ("package://arm/meshes/link.stl", True),
        ("package://arm/urdf/arm.xacro", True),
        ("package://arm/../secret.stl", False),
        ("package://arm/config.yaml", False),
        ("file:///etc/passwd", False),
    ],
)
def test_assets(uri: str, served: bool) -> None:
    """Models, textures and descriptions of robots may be fetched, and nothing else."""
    assert FoxgloveSettings().serves_asset(uri) is served
