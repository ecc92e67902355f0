"""ropeway.gateway.process.open_files: room for connections, and what is done where there is little."""

from __future__ import annotations

import subprocess
import sys

CODE = """
import logging, resource, sys
logging.basicConfig(format="%(message)s", level="INFO")
from ropeway.errors import GraphUnavailable
from ropeway.gateway.process.open_files import make_room
resource.setrlimit(resource.RLIMIT_NOFILE, (min(300, int(sys.argv[1])), int(sys.argv[1])))
try:
    room = make_room(int(sys.argv[2]))
except GraphUnavailable as error:
    sys.exit(str(error))
print(room.clients, room.pending, resource.getrlimit(resource.RLIMIT_NOFILE)[0])
"""


def run(hard: int, clients: int) -> subprocess.CompletedProcess[str]:
    command = [sys.executable, "-c", CODE, str(hard), str(clients)]
    return subprocess.run(command, capture_output=True, text=True, check=False)


def test_raises_the_limit() -> None:
    """As many files are allowed as clients, those who wait and the gateway itself need, and no more."""
    done = run(5000, 1000)
    assert done.stdout == "1000 1024 2536\n"
    assert done.stderr == ""


def test_says_what_there_is() -> None:
    """Where the system allows fewer, the log says how many clients have room, and some is left for who waits."""
    done = run(1000, 10_000)
    clients, pending, limit = map(int, done.stdout.split())
    assert limit == 1000
    assert pending >= 100
    assert clients + pending < 1000
    assert f"there is room for {clients} clients, not for the 10000" in done.stderr


def test_does_not_start_with_too_few() -> None:
    """Where next to no files may be open, that is an error which says how to allow more."""
    done = run(64, 10)
    assert done.returncode == 1
    assert "ulimit -n" in done.stderr
    assert "LimitNOFILE" in done.stderr
