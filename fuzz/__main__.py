"""``python -m fuzz``: fuzz targets for a while, list them, or run one input."""

from __future__ import annotations

import argparse
import subprocess
import sys
from pathlib import Path

from fuzz.engine import corpus, fuzz, load
from fuzz.guard import Guard
from fuzz.targets import MODULES


def main() -> int:
    """Do what the command line says; the exit status tells how many targets have faults."""
    parser = argparse.ArgumentParser(prog="python -m fuzz", description=__doc__)
    parser.add_argument("targets", nargs="*", help="which; all without")
    parser.add_argument("--seconds", type=int, default=600, help="for each target (600)")
    parser.add_argument("--faults", type=Path, default=Path("out/fuzz"), help="where inputs go that are faults")
    parser.add_argument("--input", type=Path, help="run this file, and what is kept, instead of fuzzing")
    parser.add_argument("--list", action="store_true", help="name the targets")
    asked = parser.parse_args()
    unknown = set(asked.targets) - set(MODULES)
    if unknown:
        parser.error(f"no target {', '.join(sorted(unknown))}; there are {', '.join(MODULES)}")
    names = asked.targets or list(MODULES)
    if asked.list:
        print("\n".join(names))
        return 0
    if asked.input is not None:
        guards = {name: Guard(load(name)) for name in names}
        for name, guard in guards.items():
            for path in [asked.input, *corpus(name)]:
                print(f"{name}: {path}")
                guard.check(path.read_bytes())
        return 0
    if len(names) == 1:
        fuzz(names[0], asked.seconds, asked.faults)
    failed = [name for name in names if not _apart(name, asked.seconds, asked.faults)]
    print(f"{len(names)} targets, faults in {len(failed)}: {', '.join(failed)}" if failed else "no faults")
    return len(failed)


def _apart(name: str, seconds: int, faults: Path) -> bool:
    """Fuzz in a process of its own, as libFuzzer ends the one it is in; true if there was no fault."""
    print(f"── {name}", flush=True)
    command = [sys.executable, "-m", "fuzz", name, f"--seconds={seconds}", f"--faults={faults}"]
    return subprocess.run(command, check=False).returncode == 0


sys.exit(main())
