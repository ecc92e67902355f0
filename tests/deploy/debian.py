"""A small Debian with Python in a directory, for what is to be tried on a machine that has nothing else."""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
from pathlib import Path
from typing import Final

import pytest

from tests.deploy.place import ROOT

__all__ = ["debian", "need", "wheelhouse"]

_CACHE: Final = Path(os.environ.get("ROPEWAY_DEBIAN", "/var/tmp/ropeway-debian"))
_SUITE: Final = "bookworm"
_PACKAGES: Final = "python3,python3-venv,ca-certificates,iproute2"


def need(*programs: str) -> None:
    """Skip the test where it is not run by root, or one of ``programs`` is not installed."""
    if os.geteuid() != 0:
        pytest.skip("needs root")
    for program in programs:
        if shutil.which(program) is None:
            pytest.skip(f"needs {program}")


def debian() -> Path:
    """Return the directory of the system, which is made the first time (some minutes) and then kept."""
    need("debootstrap")
    found = _CACHE / f"{_SUITE}-amd64"
    if not (found / "usr/bin/python3").exists():
        shutil.rmtree(found, ignore_errors=True)
        new = found.with_suffix(".new")
        shutil.rmtree(new, ignore_errors=True)
        new.parent.mkdir(parents=True, exist_ok=True)
        subprocess.run(["debootstrap", "--variant=minbase", f"--include={_PACKAGES}", _SUITE, str(new)], check=True)
        new.rename(found)
    return found


def wheelhouse(directory: Path) -> Path:
    """Return a directory with wheels of Ropeway, of all that it needs and of what builds it, for Debian's Python.

    Skips the test where this Python is another than Debian's.
    """
    if sys.version_info[:2] != (3, 11):
        pytest.skip("needs the Python of Debian 12, to gather wheels for it")
    wanted = [f"{ROOT}[all]", "hatchling", "regex"]  # Debian's 3.11.2 needs the last, the Python here perhaps not
    subprocess.run(
        [sys.executable, "-m", "pip", "wheel", "--quiet", "--wheel-dir", str(directory), *wanted],
        check=True,
    )
    return directory
