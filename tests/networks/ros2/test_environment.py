"""Whether ROS 2 can be used, and what is said where not."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import pytest

from ropeway.networks.ros2.environment import domain_of_environment

ASK = "from ropeway.networks.ros2 import rclpy_fault; print(rclpy_fault())"


def fault(path: str, **environ: str) -> str:
    """What a fresh process says whose only packages from elsewhere are at ``path``."""
    env = {"PYTHONPATH": path, **environ}
    done = subprocess.run([sys.executable, "-c", ASK], capture_output=True, text=True, env=env, check=True)
    return done.stdout.strip()


def test_without_ros() -> None:
    """Without ROS the words say to source it, and which graph needs none."""
    said = fault("")
    assert "source /opt/ros/<distro>/setup.bash before starting ropeway" in said
    assert "dds:0" in said


def test_other_python() -> None:
    """A sourced ROS without rclpy for this Python is named."""
    said = fault("", ROS_DISTRO="humble")
    assert "ROS 2 humble is sourced" in said
    assert f"{sys.version_info.major}.{sys.version_info.minor}" in said


def test_broken_rclpy(tmp_path: Path) -> None:
    """An rclpy that does not load is said to, with its reason."""
    (tmp_path / "rclpy").mkdir()
    (tmp_path / "rclpy" / "__init__.py").write_text("raise ImportError('librcl.so is not there')\n")
    said = fault(str(tmp_path))
    assert "does not load" in said
    assert "librcl.so is not there" in said


def test_imports_nothing() -> None:
    """The modules of the graph can be imported where there is no rclpy, and do not import it where there is."""
    program = (
        "import sys, ropeway.networks.ros2; assert 'rclpy' not in sys.modules; assert 'cyclonedds' not in sys.modules"
    )
    subprocess.run([sys.executable, "-c", program], check=True)


def test_domain() -> None:
    """The domain is that of ROS_DOMAIN_ID, 0 where it is not set, and must be one."""
    assert domain_of_environment({}) == 0
    assert domain_of_environment({"ROS_DOMAIN_ID": " 7 "}) == 7
    for wrong in ("seven", "-1", "233"):
        with pytest.raises(ValueError, match="expected a number from 0 to 232"):
            domain_of_environment({"ROS_DOMAIN_ID": wrong})
