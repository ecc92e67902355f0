"""Every parser under the fuzzer: for a moment each, and once more with whatever was a fault before."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import pytest
from fuzz.engine import CORPUS, corpus, load
from fuzz.guard import Guard
from fuzz.targets import MODULES

SECONDS = int(os.environ.get("ROPEWAY_FUZZ_SECONDS", "4"))
ROOT = Path(__file__).parents[2]


@pytest.mark.parametrize("name", MODULES)
def test_reads_what_it_is_given(name: str) -> None:
    """A target takes its own good inputs, nothing at all, and each input that was a fault before."""
    target = load(name)
    guard = Guard(target)
    for data in [b"", *target.seeds(), *(path.read_bytes() for path in corpus(name))]:
        guard.check(data)


def test_keeps_inputs_of_targets_only() -> None:
    """Whatever is kept belongs to a target, and is small."""
    for path in CORPUS.glob("*/*"):
        assert path.parent.name in MODULES
        assert path.stat().st_size <= load(path.parent.name).longest_bytes


@pytest.mark.slow
@pytest.mark.timeout(SECONDS + 120)
@pytest.mark.parametrize("name", MODULES)
def test_holds_against_the_fuzzer(name: str, tmp_path: Path) -> None:
    """Inputs that reach ever more branches raise only the parser's own errors, and cost no more than they may."""
    pytest.importorskip("atheris", reason="needs atheris, which has wheels for Linux on x86-64 up to Python 3.13")
    command = [sys.executable, "-m", "fuzz", name, f"--seconds={SECONDS}", f"--faults={tmp_path}"]
    run = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, check=False)
    found = {path.name: path.read_bytes()[:400] for path in tmp_path.iterdir()}
    assert run.returncode == 0, f"{found}\n{run.stdout[-4000:]}\n{run.stderr[-4000:]}"
