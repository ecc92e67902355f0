from __future__ import annotations

import subprocess
import sys

CODE = """
import logging, resource, sys
logging.basicConfig(format="%(message)s", level="INFO")
from ropeway.gateway.files import allow_open_files
resource.setrlimit(resource.RLIMIT_NOFILE, (300, int(sys.argv[1])))
print(allow_open_files(int(sys.argv[2])), resource.getrlimit(resource.RLIMIT_NOFILE)[0])
"""


def run(hard: int, connections: int) -> subprocess.CompletedProcess[str]:
    command = [sys.executable, "-c", CODE, str(hard), str(connections)]
    return subprocess.run(command, capture_output=True, text=True, check=True)


def test_raises_the_limit() -> None:
    """As many files are allowed as the connections need, and no more."""
    done = run(5000, 1000)
    assert done.stdout == "1512 1512\n"
    assert done.stderr == ""


def test_says_what_there_is() -> None:
    """Where the system allows fewer, the log says how many connections have room."""
    done = run(1000, 10_000)
    assert done.stdout == "1000 1000\n"
    assert "there is room for 488 connections" in done.stderr


def test_lowers_nothing() -> None:
    """A limit that is high enough stays."""
    assert run(300, 0).stdout == "300 300\n"
