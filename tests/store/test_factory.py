"""ropeway.store.factory."""

from __future__ import annotations

from pathlib import Path

import pytest

from ropeway.store.factory import default_path, is_mongo, make_backend
from ropeway.store.files import FilesBackend
from ropeway.store.sqlite import SqliteBackend


@pytest.mark.parametrize(
    ("url", "mongo"),
    [
        ("mongodb://host/values", True),
        ("mongodb+srv://host/values", True),
        ("mongodb.sqlite", False),
        ("/var/mongodb://x", False),
    ],
)
def test_databases_elsewhere(url: str, mongo: bool) -> None:
    """URLs of MongoDB are told from paths that look like them."""
    assert is_mongo(url) is mongo


def test_paths(tmp_path: Path) -> None:
    """A directory, also one that is not there yet, keeps JSON files; any other path is an SQLite file."""
    assert isinstance(make_backend(str(tmp_path)), FilesBackend)
    assert isinstance(make_backend(f"{tmp_path}/new/"), FilesBackend)
    assert isinstance(make_backend(str(tmp_path / "values.sqlite")), SqliteBackend)
    assert isinstance(make_backend("memory:"), SqliteBackend)


def test_default_path(monkeypatch: pytest.MonkeyPatch) -> None:
    """Values are kept where the desktop keeps state, by the name of the gateway."""
    monkeypatch.setenv("XDG_STATE_HOME", "/state")
    assert default_path("robot") == "/state/ropeway/robot.sqlite"
    monkeypatch.delenv("XDG_STATE_HOME")
    monkeypatch.setenv("HOME", "/home/me")
    assert default_path("robot") == "/home/me/.local/state/ropeway/robot.sqlite"
