"""ropeway.networks.dds.library: which Cyclone DDS is taken."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import pytest

from ropeway.networks.dds import library
from ropeway.networks.dds.library import LibraryMissing

from .conftest import needs_elf


@pytest.fixture(autouse=True)
def nothing_else(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    """Nothing is found but what a test makes."""
    monkeypatch.setattr(library, "_wheel", lambda: None)
    monkeypatch.setattr(library, "_ROS_FOLDER", tmp_path / "ros")
    monkeypatch.setattr(library, "_SYSTEM_FOLDERS", (str(tmp_path / "system"),))


def built(path: Path, name: str, *needs: Path) -> Path:
    """Compile a library that has one function, called ``name``, and needs others; it does not know where they are."""
    path.parent.mkdir(parents=True, exist_ok=True)
    calls = "".join(f"int {need.name.split('.')[0]}(void); " for need in needs)
    sums = "".join(f" + {need.name.split('.')[0]}()" for need in needs)
    source = path.with_suffix(".c")
    source.write_text(f"{calls} int {name}(void) {{ return 1{sums}; }}")
    command = ["cc", "-shared", "-fPIC", "-o", str(path), str(source), f"-Wl,-soname,{path.name}", *map(str, needs)]
    subprocess.run(command, check=True)
    return path


@needs_elf
def test_order(tmp_path: Path) -> None:
    """What the user has set up goes before what ROS 2 has, newest distribution first, and both before the system's."""
    made = [
        built(tmp_path / "system" / "libddsc.so.0.10.2", "ddsc"),
        built(tmp_path / "ros" / "humble" / "lib" / "x86_64-linux-gnu" / "libddsc.so.0.10.5", "ddsc"),
        built(tmp_path / "ros" / "jazzy" / "lib" / "libddsc.so.0.10.5", "ddsc"),
        built(tmp_path / "sourced" / "lib" / "libddsc.so.0.10.4", "ddsc"),
        built(tmp_path / "home" / "lib" / "libddsc.so.11.0.1", "ddsc"),
    ]
    environment = {"CYCLONEDDS_HOME": str(tmp_path / "home"), "AMENT_PREFIX_PATH": str(tmp_path / "sourced")}
    while made:
        found = library.find(environment)
        assert (found.path, found.version) == (made[-1], library.version_of(made[-1]))
        made.pop().unlink()
    with pytest.raises(LibraryMissing):
        library.find(environment)


@needs_elf
def test_other_versions_are_passed_over(tmp_path: Path) -> None:
    """A version whose layouts are not known is not loaded; if there is no other, the error names it."""
    old = built(tmp_path / "home" / "lib" / "libddsc.so.0.8.2", "ddsc")
    environment = {"CYCLONEDDS_HOME": str(tmp_path / "home")}
    with pytest.raises(LibraryMissing, match=r"libddsc\.so\.0\.8\.2 is of version 0\.8\.2\. Install"):
        library.find(environment)
    good = built(tmp_path / "system" / "libddsc.so.0.10.5", "ddsc")
    assert library.find(environment).path == good
    assert old.exists()


@needs_elf
def test_a_library_that_needs_others(tmp_path: Path) -> None:
    """A ROS 2 that is not sourced works: what its library needs is found beside it."""
    folder = tmp_path / "ros" / "humble" / "lib"
    posh = built(folder / "libposh_of_test.so", "libposh_of_test")
    binding = built(folder / "libbinding_of_test.so", "libbinding_of_test", posh)
    path = built(folder / "x86_64-linux-gnu" / "libddsc.so.0.10.5", "ddsc", binding)
    found = library.find({})
    assert found.path == path
    assert found.dll.ddsc() == 3


def test_what_cannot_be_loaded(tmp_path: Path) -> None:
    """A file that is no library is passed over, and the error names it."""
    broken = tmp_path / "system" / "libddsc.so.0.10.2"
    broken.parent.mkdir()
    broken.write_bytes(b"no library")
    with pytest.raises(LibraryMissing, match=r"libddsc\.so\.0\.10\.2 cannot be loaded"):
        library.find({})


def test_a_library_that_is_named(tmp_path: Path) -> None:
    """The variable decides alone: if what it names cannot be used, nothing else is taken."""
    with pytest.raises(LibraryMissing, match=r"ROPEWAY_DDS_LIBRARY=.*gone\.so"):
        library.find({library.ENVIRONMENT: str(tmp_path / "gone.so")})


@pytest.mark.parametrize(
    ("name", "version"),
    [
        ("libddsc.so.0.10.2", "0.10.2"),
        ("libddsc-ad12c33a.so.11.0.1", "11.0.1"),
        ("libddsc.0.10.5.dylib", "0.10.5"),
        ("libddsc.so.0debian", ""),
        ("ddsc-1f.dll", ""),
    ],
)
def test_version(name: str, version: str) -> None:
    """The version of a library is told by the name of its file, if at all."""
    assert library.version_of(Path("/lib") / name) == version


def test_advice() -> None:
    """Without any library, one sentence says what to install."""
    with pytest.raises(LibraryMissing) as caught:
        library.find({})
    wanted = "apt install" if sys.platform == "linux" else "pip install"
    assert wanted in str(caught.value)
