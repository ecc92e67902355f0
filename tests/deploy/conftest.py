"""The packages for Debian, built once for all that install them."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import pytest

from tests.deploy.debian import need
from tests.deploy.place import ROOT


@pytest.fixture(scope="session")
def packages(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Path]:
    """The packages of both architectures; ``ROPEWAY_DEBS`` names a directory that has them already."""
    need("dpkg-deb")
    there = os.environ.get("ROPEWAY_DEBS")
    out = Path(there) if there else tmp_path_factory.mktemp("debs")
    if not there:
        subprocess.run(
            [sys.executable, "deploy/debian/build.py", "amd64", "arm64", "--out", str(out)], cwd=ROOT, check=True
        )
    return {file.stem.rpartition("_")[2]: file for file in out.glob("ropeway_*.deb")}
