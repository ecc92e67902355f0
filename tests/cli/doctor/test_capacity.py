"""ropeway.cli.doctor.capacity: what a gateway can carry on this machine."""

from __future__ import annotations

import os
from pathlib import Path

import pytest

from ropeway.cli.doctor import capacity as module
from ropeway.cli.doctor.capacity import Costs, capacity, processors
from ropeway.errors import ConnectFailed


def machine(root: Path, quotas: dict[str, str], group: str = "/robot.slice/gateway.service") -> Path:
    """Make the files of a process in a control group whose folders have these limits."""
    (root / "proc/self").mkdir(parents=True)
    (root / "proc/self/cgroup").write_text(f"12:cpu:/old\n0::{group}\n")
    for folder, text in quotas.items():
        path = root / "sys/fs/cgroup" / folder
        path.mkdir(parents=True, exist_ok=True)
        (path / "cpu.max").write_text(text)
    return root


def test_quota(tmp_path: Path) -> None:
    """The least limit of the control groups that a process is in counts, wherever it is set."""
    quotas = {"robot.slice": "25000 100000\n", "robot.slice/gateway.service": "max 100000\n", "other": "1000 100000"}
    assert processors(machine(tmp_path, quotas)) == 0.25


def test_quota_of_version_1(tmp_path: Path) -> None:
    """The limits of control groups of version 1 count, too."""
    (tmp_path / "proc/self").mkdir(parents=True)
    (tmp_path / "proc/self/cgroup").write_text("2:cpuset:/box\n1:cpu,cpuacct:/box\n")
    for folder, quota in (("", -1), ("box", 50_000)):
        path = tmp_path / "sys/fs/cgroup/cpu,cpuacct" / folder
        path.mkdir(parents=True, exist_ok=True)
        (path / "cpu.cfs_quota_us").write_text(f"{quota}\n")
        (path / "cpu.cfs_period_us").write_text("100000\n")
    assert processors(tmp_path) == 0.5


@pytest.mark.parametrize("text", ["max 100000\n", "", "many few\n"])
def test_no_quota(tmp_path: Path, text: str) -> None:
    """Without a limit that can be read a process may use the processors that it is bound to."""
    root = machine(tmp_path, {"robot.slice": text})
    assert processors(root) == len(os.sched_getaffinity(0))
    assert processors(tmp_path / "nowhere") == len(os.sched_getaffinity(0))


def test_measured_here() -> None:
    """Two gateways pass messages on, and it is told how many this machine can carry."""
    (symptom,) = capacity()
    assert symptom.ok
    assert "messages of 1 kB a second one by one" in symptom.text


def test_small_share(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """A tenth of the time carries a tenth, and too little of it is said with what to do."""

    async def measure() -> Costs:
        return Costs(25e-6, 5e-6, 300e-6)

    monkeypatch.setattr(module, "measure", measure)
    (symptom,) = capacity(machine(tmp_path, {"robot.slice": "5000 100000"}))
    assert symptom.ok is None
    assert "2,000 messages of 1 kB a second one by one, 10,000 in bursts, or 50 MB/s" in symptom.text
    assert "CPUQuota=" in symptom.remedy


def test_not_measured(monkeypatch: pytest.MonkeyPatch) -> None:
    """What cannot be measured is said, and the doctor goes on."""

    async def measure() -> Costs:
        raise ConnectFailed("ws://127.0.0.1:1", "refused")

    monkeypatch.setattr(module, "measure", measure)
    (symptom,) = capacity()
    assert symptom.ok is None
    assert "could not be measured" in symptom.text
