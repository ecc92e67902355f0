"""tests.support.scheduling: a parallel test run ends whatever its processes do."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import pytest

pytest.importorskip("xdist")
ROOT = Path(__file__).parents[1]


@pytest.mark.parametrize(("crashing", "test"), [([0], 0), ([5], 4), ([1, 2, 4], 3), ([1, 2, 4], 0)])
def test_a_crash(tmp_path: Path, crashing: list[int], test: int) -> None:
    """A process that crashes costs the one test that it ran; all others are run, and the run ends."""
    (tmp_path / "pytest.ini").write_text("[pytest]\n")
    (tmp_path / "conftest.py").write_text("from tests.conftest import pytest_xdist_make_scheduler\n")
    for number in range(6):
        crash = f"import os\nos._exit(11) if number == {test} else None" if number in crashing else "pass"
        (tmp_path / f"test_{number}.py").write_text(
            "import pytest\n\n@pytest.mark.parametrize('number', range(5))\ndef test_it(number):\n"
            + "".join(f"    {line}\n" for line in crash.splitlines())
        )
    command = ["-q", "-p", "no:cacheprovider", "-n", "2", "--dist", "loadfile", "--no-loadscope-reorder"]
    ran = subprocess.run(
        [sys.executable, "-m", "pytest", *command, str(tmp_path)],
        cwd=tmp_path,
        env={"PYTHONPATH": str(ROOT), "PATH": ""},
        capture_output=True,
        text=True,
        timeout=200,
        check=False,
    )
    assert f"{len(crashing)} failed, {30 - len(crashing)} passed" in ran.stdout, ran.stdout + ran.stderr
