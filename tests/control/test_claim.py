"""ropeway.control.claim: the UNIX socket of a gateway."""

from __future__ import annotations

import os
import socket
import stat
import subprocess
import sys
from contextlib import closing
from pathlib import Path

import pytest

from ropeway.control.claim import SocketClaim
from ropeway.errors import ControlUnavailable, NameTaken


def test_only_the_user_may_connect(tmp_path: Path) -> None:
    """The socket is there for its user alone, and gone once it is closed."""
    path = tmp_path / "a.sock"
    with closing(SocketClaim(path)):
        assert stat.S_IMODE(path.lstat().st_mode) == 0o600
    assert not path.exists()


def test_a_living_owner_keeps_the_name(tmp_path: Path) -> None:
    """A name is refused while its owner runs, with the number of the process, and had afterwards."""
    path = tmp_path / "a.sock"
    with closing(SocketClaim(path)):
        with pytest.raises(NameTaken, match=f"process {os.getpid()} runs a gateway"):
            SocketClaim(path)
        assert path.exists()
    SocketClaim(path).close()


def test_a_dead_owner_is_replaced(tmp_path: Path) -> None:
    """The socket of a process that was killed is taken over."""
    path = tmp_path / "a.sock"
    code = "from pathlib import Path; from ropeway.control.claim import SocketClaim"
    code += f"; claim = SocketClaim(Path({str(path)!r})); print()"
    owner = subprocess.Popen([sys.executable, "-c", code + "; input()"], stdin=subprocess.PIPE, stdout=subprocess.PIPE)
    assert owner.stdout is not None
    owner.stdout.readline()
    owner.kill()
    owner.communicate()
    assert path.exists()
    with closing(SocketClaim(path)) as claim, closing(socket.socket(socket.AF_UNIX)) as client:
        client.connect(str(path))
        claim.socket.accept()[0].close()


def test_a_stranger_who_listens_is_left_alone(tmp_path: Path) -> None:
    """A socket that another program answers, which knows no lock, is not taken from it."""
    path = tmp_path / "a.sock"
    with closing(socket.socket(socket.AF_UNIX)) as other:
        other.bind(str(path))
        other.listen()
        with pytest.raises(NameTaken, match="another process listens there"):
            SocketClaim(path)
    assert path.exists()


@pytest.mark.parametrize("kind", ["file", "directory"])
def test_what_is_no_socket_is_left_alone(tmp_path: Path, kind: str) -> None:
    """A file or a directory of the name is not removed; the error says what to do."""
    path = tmp_path / "a.sock"
    if kind == "file":
        path.write_text("mine")
    else:
        path.mkdir()
    with pytest.raises(ControlUnavailable, match="is no socket; remove it"):
        SocketClaim(path)
    assert path.exists()


@pytest.mark.skipif(os.geteuid() != 0, reason="only root can make files of others")
def test_the_socket_of_somebody_else_is_refused(tmp_path: Path) -> None:
    """A socket of another user is not removed; the error names the user."""
    path = tmp_path / "a.sock"
    with closing(socket.socket(socket.AF_UNIX)) as other:
        other.bind(str(path))
    os.chown(path, 12345, 12345)
    with pytest.raises(ControlUnavailable, match="user with number 12345"):
        SocketClaim(path)
    assert path.exists()
