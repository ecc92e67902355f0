"""Looks at ROS and DDS: what is installed, what is sourced, and settings that keep nodes from finding each other."""

from __future__ import annotations

import socket
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Final
from urllib.parse import urlsplit

from ropeway.cli.doctor.symptom import Symptom

__all__ = ["robotics"]

_ROS: Final = Path("/opt/ros")
_ANSWER_S: Final = 1.0
_RMWS: Final = ("rmw_cyclonedds_cpp", "rmw_fastrtps_cpp", "rmw_fastrtps_dynamic_cpp", "rmw_connextdds")
_MOST_DOMAIN: Final = 232


def robotics(environ: Mapping[str, str], *, installed: Path = _ROS) -> Iterator[Symptom]:
    """Yield what there is to say of ROS, by the environment and by what is installed."""
    yield from _installations(environ, installed)
    yield from _domain(environ)
    yield from _middleware(environ)
    yield from _range(environ)
    for name in ("CYCLONEDDS_URI", "FASTRTPS_DEFAULT_PROFILES_FILE", "FASTDDS_DEFAULT_PROFILES_FILE"):
        yield from _file(environ, name)
    yield from _master(environ)


def _installations(environ: Mapping[str, str], installed: Path) -> Iterator[Symptom]:
    found = sorted(path.name for path in installed.iterdir() if path.is_dir()) if installed.is_dir() else []
    sourced = environ.get("ROS_DISTRO", "")
    if sourced:
        yield Symptom(True, "ros", f"ROS {sourced} is sourced (installed: {', '.join(found) or 'elsewhere'})")
    elif found:
        text = f"ROS is installed ({', '.join(found)}) and not sourced: dds graphs work, ros2 graphs do not"
        yield Symptom(None, "ros", text, f"for ros2 graphs: source {installed / found[-1]}/setup.bash")
    else:
        yield Symptom(True, "ros", "no ROS is installed; dds, zenoh, ws, overlay, iort and mqtt graphs need none")


def _domain(environ: Mapping[str, str]) -> Iterator[Symptom]:
    domain = environ.get("ROS_DOMAIN_ID", "").strip()
    if not domain:
        yield Symptom(True, "domain", "ROS_DOMAIN_ID is not set: domain 0")
    elif domain.isdigit() and int(domain) <= _MOST_DOMAIN:
        yield Symptom(True, "domain", f"ROS_DOMAIN_ID is {int(domain)}: the default graph is dds:{int(domain)}")
    else:
        text = f"ROS_DOMAIN_ID is {domain!r}"
        yield Symptom(False, "domain", text, f"set it to a number from 0 to {_MOST_DOMAIN}, or unset it")


def _middleware(environ: Mapping[str, str]) -> Iterator[Symptom]:
    middleware = environ.get("RMW_IMPLEMENTATION", "")
    if not middleware:
        return
    if middleware in _RMWS:
        yield Symptom(True, "rmw", f"RMW_IMPLEMENTATION is {middleware}: dds graphs reach its nodes")
    elif middleware == "rmw_zenoh_cpp":
        text = f"RMW_IMPLEMENTATION is {middleware}: zenoh graphs reach its nodes, dds graphs do not"
        yield Symptom(None, "rmw", text, "use the graph zenoh, as in ropeway topic list -g zenoh")
    else:
        text = f"RMW_IMPLEMENTATION is {middleware}, which is not DDS: dds graphs do not reach its nodes"
        yield Symptom(None, "rmw", text, "use the graph ros2, which goes through the sourced ROS 2")


def _range(environ: Mapping[str, str]) -> Iterator[Symptom]:
    reach = environ.get("ROS_AUTOMATIC_DISCOVERY_RANGE", "").strip().upper()
    if reach == "OFF":
        yield Symptom(
            None,
            "discovery",
            "ROS_AUTOMATIC_DISCOVERY_RANGE is OFF: nodes find only the peers in ROS_STATIC_PEERS",
            "set it to SUBNET or LOCALHOST if nodes are missing",
        )
    elif reach == "LOCALHOST" or environ.get("ROS_LOCALHOST_ONLY", "") == "1":
        yield Symptom(
            None,
            "discovery",
            "discovery is limited to this machine",
            "for nodes elsewhere set ROS_AUTOMATIC_DISCOVERY_RANGE=SUBNET, and unset ROS_LOCALHOST_ONLY",
        )


def _file(environ: Mapping[str, str], name: str) -> Iterator[Symptom]:
    value = environ.get(name, "")
    for part in value.split(","):
        path = part.strip().removeprefix("file://")
        if path and not path.startswith("<") and not Path(path).is_file():
            text = f"{name} names {path}, which does not exist"
            yield Symptom(False, "settings", text, f"mend the path, or unset {name}")


def _master(environ: Mapping[str, str]) -> Iterator[Symptom]:
    uri = environ.get("ROS_MASTER_URI", "")
    if not uri:
        return
    parts = urlsplit(uri)
    try:
        socket.create_connection((parts.hostname or "", parts.port or 11311), timeout=_ANSWER_S).close()
    except (OSError, ValueError) as error:
        text = f"no ROS 1 master answers at ROS_MASTER_URI ({uri}): {error}"
        yield Symptom(None, "ros1", text, "start roscore there; only ros1 graphs need it")
    else:
        yield Symptom(True, "ros1", f"a ROS 1 master answers at {uri}")
