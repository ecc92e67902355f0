"""Finds out whether this process can use ROS 2, and if not, why and what helps."""

from __future__ import annotations

import ctypes
import importlib
import importlib.util
import os
import sys
from collections.abc import Mapping
from functools import lru_cache

__all__ = ["MAX_DOMAIN", "domain_of_environment", "rclpy_fault"]

MAX_DOMAIN = 232  # the highest whose UDP ports exist


@lru_cache(maxsize=1)
def rclpy_fault() -> str:
    """Return why rclpy cannot be used, with what to do about it; ``""`` if it can. The first call imports it."""
    version = f"{sys.version_info.major}.{sys.version_info.minor}"
    try:
        found = importlib.util.find_spec("rclpy") is not None
    except ValueError:
        found = False
    if not found:
        distro = os.environ.get("ROS_DISTRO", "")
        if distro:
            return (
                f"ROS 2 {distro} is sourced, but Python {version} finds no rclpy in it; run ropeway with the python3 "
                "that this ROS was made for, or write dds:0, which needs no ROS"
            )
        return (
            "rclpy cannot be imported; source /opt/ros/<distro>/setup.bash before starting ropeway, or write dds:0, "
            "which needs no ROS"
        )
    rmw = os.environ.get("RMW_IMPLEMENTATION", "")
    if rmw:
        try:
            ctypes.CDLL(f"lib{rmw}.so")  # rcl ends the process where it cannot load it
        except OSError as error:
            return (
                f"RMW_IMPLEMENTATION is {rmw}, which does not load ({_first_line(error)}); install "
                f"ros-$ROS_DISTRO-{rmw.replace('_', '-')}, or unset RMW_IMPLEMENTATION"
            )
    try:
        importlib.import_module("rclpy")
        importlib.import_module("rclpy.node")
    except (ImportError, OSError, RuntimeError) as error:
        return (
            f"rclpy is there, but does not load into Python {version} ({_first_line(error)}); run ropeway with the "
            "python3 that this ROS was made for, and source its setup.bash in the same shell"
        )
    return ""


def domain_of_environment(environ: Mapping[str, str] | None = None) -> int:
    """Return the domain that ROS is told to use. Raises ``ValueError`` where ``ROS_DOMAIN_ID`` is no domain."""
    text = (os.environ if environ is None else environ).get("ROS_DOMAIN_ID", "").strip() or "0"
    if not text.isdecimal() or int(text) > MAX_DOMAIN:
        raise ValueError(f'ROS_DOMAIN_ID is "{text}"; expected a number from 0 to {MAX_DOMAIN}')
    return int(text)


def _first_line(error: BaseException) -> str:
    return (str(error).strip() or type(error).__name__).splitlines()[0]
