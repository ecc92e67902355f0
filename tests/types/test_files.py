"""Finding definition files."""

from __future__ import annotations

from pathlib import Path

import pytest

from ropeway.errors import InvalidDefinition
from ropeway.types.files import find_interfaces, find_share, read_text


def write(path: Path, text: str = "int8 a\n") -> Path:
    """Make a file and the directories above it."""
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text(text)
    return path


def test_share_tree(tmp_path: Path) -> None:
    """A share tree gives messages, services and actions; a .msg goes before the .idl that repeats it."""
    message = write(tmp_path / "share/p/msg/A.msg")
    write(tmp_path / "share/p/msg/A.idl")
    write(tmp_path / "share/p/srv/S.srv")
    write(tmp_path / "share/q/action/G.action")
    only = write(tmp_path / "share/q/msg/Only.idl")
    write(tmp_path / "share/q/msg/notes.txt")
    write(tmp_path / "share/q/stray.msg")
    found = find_interfaces(tmp_path / "share")
    assert set(found) == {"p/msg/A", "p/srv/S", "q/action/G", "q/msg/Only"}
    assert (found["p/msg/A"], found["q/msg/Only"]) == (message, only)
    assert find_share(tmp_path / "share") == found


def test_source_package(tmp_path: Path) -> None:
    """A source package is named by its package.xml, and a subdirectory of msg does not matter."""
    write(tmp_path / "checkout/package.xml", "<package><name>real_name</name></package>")
    write(tmp_path / "checkout/msg/A.msg")
    write(tmp_path / "checkout/msg/more/B.msg")
    assert set(find_interfaces(tmp_path / "checkout")) == {"real_name/msg/A", "real_name/msg/B"}


def test_single_file(tmp_path: Path) -> None:
    """A single file is named by its place."""
    file = write(tmp_path / "p/msg/A.msg")
    assert find_interfaces(file) == {"p/msg/A": file}


def test_faults(tmp_path: Path) -> None:
    """A path that is not there, or tells no name, is refused with its name."""
    with pytest.raises(InvalidDefinition, match="no such file or directory"):
        find_interfaces(tmp_path / "nothing")
    with pytest.raises(InvalidDefinition, match=r"a definition stands at PACKAGE/msg/Name\.msg"):
        find_interfaces(write(tmp_path / "A.msg"))
    with pytest.raises(InvalidDefinition, match="a definition stands at"):
        find_interfaces(write(tmp_path / "p/msg/bad-name.msg"))
    with pytest.raises(InvalidDefinition, match="No such file"):
        read_text(tmp_path / "gone.msg", "p/msg/Gone")
