"""The units for systemd."""

from __future__ import annotations

import re
import shutil
import subprocess
from pathlib import Path

import pytest

from tests.deploy.place import DEPLOY

UNITS = sorted((DEPLOY / "systemd").glob("*.service"))

pytestmark = pytest.mark.skipif(shutil.which("systemd-analyze") is None, reason="systemd-analyze is not installed")


def test_both_are_there() -> None:
    """There is a unit for a gateway and one for a router."""
    assert [unit.name for unit in UNITS] == ["ropeway-gateway.service", "ropeway-router.service"]


@pytest.mark.parametrize("unit", UNITS, ids=lambda unit: unit.stem)
def test_exposure(unit: Path) -> None:
    """What a unit leaves open is rated below 3 of 10 by systemd."""
    done = subprocess.run(
        ["systemd-analyze", "security", "--offline=yes", "--threshold=29", str(unit)], capture_output=True, text=True
    )
    assert done.returncode == 0, done.stdout.splitlines()[-1:]
    found = re.search(r"Overall exposure level for \S+: ([\d.]+)", done.stdout)
    assert found is not None
    assert float(found[1]) < 3.0


@pytest.mark.parametrize("unit", UNITS, ids=lambda unit: unit.stem)
def test_systemd_understands_it(unit: Path) -> None:
    """Systemd finds nothing to say but that the command is not installed on this machine."""
    done = subprocess.run(["systemd-analyze", "verify", "--man=no", str(unit)], capture_output=True, text=True)
    about = [line for line in done.stderr.splitlines() if "ropeway" in line and "is not executable" not in line]
    assert about == []


@pytest.mark.parametrize("unit", UNITS, ids=lambda unit: unit.stem)
def test_what_a_unit_promises(unit: Path) -> None:
    """A unit tells when it is ready, is watched, can be reloaded, and keeps its state in a directory of its own."""
    text = unit.read_text("utf-8")
    for line in ("Type=notify", "WatchdogSec=30", 'ExecReload=/bin/sh -c "kill -HUP $MAINPID"', "Restart=on-failure"):
        assert f"\n{line}\n" in text
    assert re.search(r"^StateDirectory=ropeway", text, re.MULTILINE)
