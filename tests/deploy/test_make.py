"""What `make` runs to make an environment and to install into it."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import pytest

from tests.deploy.place import ROOT

PIP = ROOT / ".ci/pip"

pytestmark = pytest.mark.skipif(sys.prefix == sys.base_prefix, reason="needs an environment of its own")


def install(*words: str) -> subprocess.CompletedProcess[str]:
    return subprocess.run([str(PIP), sys.prefix, *words], capture_output=True, text=True, check=False)


def test_what_is_there_already() -> None:
    """What is installed already is no fault, and nothing is said of it."""
    done = install("--no-index", "pytest")
    assert (done.returncode, done.stderr) == (0, "")


def test_what_cannot_be_had(tmp_path: Path) -> None:
    """A failure is one of the whole, and what pip said is shown."""
    done = install("--no-index", f"--find-links={tmp_path}", "nothing-of-this-name")
    assert done.returncode == 1
    assert "No matching distribution found for nothing-of-this-name" in done.stderr
