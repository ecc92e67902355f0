"""ropeway.control.place: where sockets of gateways are."""

from __future__ import annotations

import os
import stat
import tempfile
from pathlib import Path

import pytest

from ropeway.control.place import own_directory, running, socket_path
from ropeway.errors import ControlUnavailable


def test_the_directory_of_the_session(tmp_path: Path) -> None:
    """Sockets stand in the user's runtime directory, in one that nobody else reads, even if it was open before."""
    made = own_directory({"XDG_RUNTIME_DIR": str(tmp_path)})
    assert made == tmp_path / "ropeway"
    made.chmod(0o777)
    assert stat.S_IMODE(own_directory({"XDG_RUNTIME_DIR": str(tmp_path)}).stat().st_mode) == 0o700


def test_without_a_session(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Without a runtime directory a private one is made among the temporary files."""
    monkeypatch.setattr(tempfile, "tempdir", str(tmp_path))
    made = own_directory({})
    assert made == tmp_path / f"ropeway-{os.geteuid()}"
    assert stat.S_IMODE(made.stat().st_mode) == 0o700


def test_a_service_has_its_own() -> None:
    """A service uses the first directory that its manager made for it."""
    assert own_directory({"RUNTIME_DIRECTORY": "/run/ropeway:/run/other"}) == Path("/run/ropeway")


def test_a_trap_is_refused(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """A link or a file that somebody left in the place of the private directory is not followed."""
    monkeypatch.setattr(tempfile, "tempdir", str(tmp_path))
    trap = tmp_path / f"ropeway-{os.geteuid()}"
    (tmp_path / "elsewhere").mkdir()
    trap.symlink_to(tmp_path / "elsewhere")
    with pytest.raises(ControlUnavailable, match="is no directory"):
        own_directory({})


@pytest.mark.skipif(os.geteuid() != 0, reason="only root can make directories of others")
def test_the_directory_of_somebody_else_is_refused(tmp_path: Path) -> None:
    """A directory of another user is not used."""
    (tmp_path / "ropeway").mkdir()
    os.chown(tmp_path / "ropeway", 12345, 12345)
    with pytest.raises(ControlUnavailable, match="belongs to the user with number 12345"):
        own_directory({"XDG_RUNTIME_DIR": str(tmp_path)})


def test_a_path_that_is_too_long(tmp_path: Path) -> None:
    """A path that no UNIX socket can have is refused with what to do."""
    with pytest.raises(ControlUnavailable, match="set XDG_RUNTIME_DIR to a shorter path"):
        socket_path(tmp_path / ("x" * 100), "robot")


def test_running(tmp_path: Path) -> None:
    """Sockets are listed by the names of their gateways."""
    directory = own_directory({"XDG_RUNTIME_DIR": str(tmp_path)})
    for name in ("b.sock", "a.sock", "a.lock"):
        (directory / name).touch()
    found = running({"XDG_RUNTIME_DIR": str(tmp_path)})
    assert {name: path for name, path in found.items() if path.parent == directory} == {
        "a": directory / "a.sock",
        "b": directory / "b.sock",
    }
