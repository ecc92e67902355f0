"""``ropeway doctor``."""

from __future__ import annotations

import json
import socket
from pathlib import Path

import pytest
from typer.testing import CliRunner

from ropeway.cli import app
from ropeway.cli.doctor.machine import machine
from ropeway.cli.doctor.robotics import robotics
from ropeway.cli.doctor.symptom import Symptom


def about(found: list[Symptom], subject: str) -> list[Symptom]:
    """Return what was found about a subject."""
    return [symptom for symptom in found if symptom.about == subject]


def test_this_machine() -> None:
    """The doctor tells the versions, as text and as JSON, and a machine that runs these tests is fit."""
    result = CliRunner().invoke(app, ["doctor"], env={"ROS_DOMAIN_ID": "0", "CYCLONEDDS_URI": ""})
    assert result.exit_code == 0
    assert result.stdout.startswith("ok  Ropeway ")
    result = CliRunner().invoke(app, ["doctor", "--json"], env={"ROS_DOMAIN_ID": "many"})
    assert result.exit_code == 1
    (domain,) = [symptom for symptom in json.loads(result.stdout) if symptom["about"] == "domain"]
    assert domain["ok"] is False
    assert "0 to 232" in domain["remedy"]


def small(root: Path) -> Path:
    """Make the files of a machine with small buffers, no bbr, and one interface without multicast."""
    for path, text in {
        "proc/sys/net/core/rmem_max": "212992",
        "proc/sys/net/core/wmem_max": "212992",
        "proc/sys/net/ipv4/tcp_available_congestion_control": "reno cubic",
        "sys/class/net/lo/flags": "0x9",
        "sys/class/net/wwan0/flags": "0x91",
        "sys/class/net/eth1/flags": "0x1002",
    }.items():
        (root / path).parent.mkdir(parents=True, exist_ok=True)
        (root / path).write_text(f"{text}\n")
    return root


def test_a_machine_with_little(tmp_path: Path) -> None:
    """Small buffers, a kernel without bbr and interfaces without multicast are told with what helps."""
    found = list(machine(small(tmp_path)))
    assert [symptom.remedy for symptom in about(found, "buffers")] == [
        "sysctl -w net.core.rmem_max=2097152",
        "sysctl -w net.core.wmem_max=2097152",
    ]
    assert about(found, "congestion")[0].remedy == "modprobe tcp_bbr"
    none, mute = about(found, "interfaces")
    assert "no interface with multicast is up" in none.text
    assert mute.remedy.startswith("ip link set wwan0 multicast on")


def test_a_taken_port() -> None:
    """A taken port is told, with what to write in the configuration."""
    with socket.socket() as other:
        try:
            other.bind(("127.0.0.1", 9090))
            other.listen()
        except OSError:
            pass  # somebody else has it, which is as good
        (symptom,) = about(list(machine()), "port")
    assert symptom.ok is None
    assert '"listen"' in symptom.remedy


def test_installations(tmp_path: Path) -> None:
    """A ROS that is installed and not sourced is told with the line that sources it."""
    (tmp_path / "jazzy").mkdir()
    (symptom,) = about(list(robotics({}, installed=tmp_path)), "ros")
    assert symptom.remedy.endswith("jazzy/setup.bash")
    (symptom,) = about(list(robotics({"ROS_DISTRO": "jazzy"}, installed=tmp_path)), "ros")
    assert symptom.ok
    (symptom,) = about(list(robotics({}, installed=tmp_path / "none")), "ros")
    assert symptom.ok


@pytest.mark.parametrize(
    ("environ", "subject", "ok"),
    [
        ({"ROS_DOMAIN_ID": "7"}, "domain", True),
        ({"ROS_DOMAIN_ID": "300"}, "domain", False),
        ({"RMW_IMPLEMENTATION": "rmw_fastrtps_cpp"}, "rmw", True),
        ({"RMW_IMPLEMENTATION": "rmw_zenoh_cpp"}, "rmw", None),
        ({"ROS_AUTOMATIC_DISCOVERY_RANGE": "off"}, "discovery", None),
        ({"ROS_LOCALHOST_ONLY": "1"}, "discovery", None),
        ({"CYCLONEDDS_URI": "file:///nowhere/cyclonedds.xml"}, "settings", False),
        ({"ROS_MASTER_URI": "http://127.0.0.1:1"}, "ros1", None),
    ],
)
def test_settings(environ: dict[str, str], subject: str, ok: bool | None) -> None:
    """Settings that keep nodes from finding each other are told."""
    (symptom,) = about(list(robotics(environ)), subject)
    assert symptom.ok is ok
    assert bool(symptom.remedy) is (ok is not True)


def test_settings_that_are_no_file() -> None:
    """Settings that are written out, and files that exist, are no fault."""
    assert about(list(robotics({"CYCLONEDDS_URI": f"<CycloneDDS/>,file://{__file__}"})), "settings") == []
