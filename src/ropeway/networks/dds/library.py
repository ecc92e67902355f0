"""Finds a Cyclone DDS C library: in the wheel, else that of a ROS 2 or of the system.

The wheel ``cyclonedds`` has none for Linux on ARM, for musl and for Python 3.14; on robots there mostly is one anyway.
Candidates are tried in order, and each is loaded only if its version is one whose memory layouts are known. That they
are really so is checked by ``selftest`` against a live participant.
"""

from __future__ import annotations

import ctypes as ct
import glob
import importlib.util
import logging
import os
import platform
import re
import sys
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Final, NamedTuple

__all__ = ["ENVIRONMENT", "KNOWN", "LAYOUTS", "Found", "Layout", "LibraryMissing", "find", "version_of"]

log = logging.getLogger("ropeway.dds")

ENVIRONMENT: Final = "ROPEWAY_DDS_LIBRARY"
"""The variable that names the library to take, and no other."""


class Layout(NamedTuple):
    """Says where a serialised sample (``struct dds_serdata_default``) has what no function tells, in bytes."""

    version: str
    timestamp: int
    size: int
    """The size without the CDR header."""
    header: int
    """The CDR header, and the payload right behind it."""


LAYOUTS: Final = (
    Layout("11.0", timestamp=32, size=64, header=116),
    Layout("0.10", timestamp=32, size=56, header=108),
    Layout("0.10 with shared memory", timestamp=32, size=72, header=124),
    Layout("0.10 with assertions", timestamp=32, size=56, header=116),
    Layout("0.10 with shared memory and assertions", timestamp=32, size=72, header=132),
)
"""The layouts that are known, on machines of 64 bits; ``selftest`` tells which the library has.

Those with assertions are of a ROS 2 that was built without ``NDEBUG``, as colcon does unless told otherwise.
"""

_ROS_FOLDER: Final = Path("/opt/ros")
_SYSTEM_FOLDERS: Final = (
    "/usr/local/lib",
    "/usr/local/lib/*-linux-gnu*",
    "/usr/lib/*-linux-gnu*",
    "/usr/lib64",
    "/usr/lib",
    "/opt/homebrew/lib",
)
KNOWN: Final = tuple(dict.fromkeys(layout.version.split()[0] for layout in LAYOUTS))
"""The versions whose functions and layouts are known."""

_NAMES: Final = ("libddsc.so*", "libddsc-*.so*", "libddsc*.dylib", "ddsc*.dll")
_VERSION: Final = re.compile(r"\.(\d+\.\d+\.\d+)(?:\.dylib)?$|^libddsc\.(\d+\.\d+\.\d+)")
_LACKING: Final = re.compile(r"^([\w.+-]+): cannot open shared object file")
_MAX_LACKING: Final = 16  # libraries that one needs and that lie beside it; Cyclone DDS has four of iceoryx


class LibraryMissing(Exception):
    """Raised when no library can be used; the text says why, and what to install."""


class Found(NamedTuple):
    """A library that is loaded, where it lies, and its version, ``""`` where its file does not tell."""

    dll: ct.CDLL
    path: Path
    version: str


def find(environment: Mapping[str, str] = os.environ) -> Found:
    """Return the first library that can be used. Raises ``LibraryMissing``."""
    told = environment.get(ENVIRONMENT, "")
    candidates = iter([Path(told)]) if told else _candidates(environment)
    refused: list[str] = []
    seen: set[Path] = set()
    for candidate in candidates:
        path = candidate.resolve()
        if path in seen:
            continue
        seen.add(path)
        version = version_of(path)
        if version and not version.startswith(tuple(f"{known}." for known in KNOWN)):
            refused.append(f"{path} is of version {version}")
            continue
        try:
            dll = _load(path)
        except OSError as error:
            refused.append(f"{path} cannot be loaded ({error})")
            continue
        log.debug("Cyclone DDS: %s", path)
        return Found(dll, path, version)
    if told:
        raise LibraryMissing(f"{ENVIRONMENT}={told} is not a usable library: {'; '.join(refused)}")
    found = f"; {'; '.join(refused)}" if refused else ""
    raise LibraryMissing(f"no Cyclone DDS library of version {' or '.join(KNOWN)} is here{found}. {_advice()}")


def version_of(path: Path) -> str:
    """Return the version that the name of a library's file tells, or ``""``."""
    match = _VERSION.search(path.name)
    return (match[1] or match[2]) if match else ""


def _candidates(environment: Mapping[str, str]) -> Iterator[Path]:
    """Yield libraries, the best first: what was installed for us, what the user has set up, what there is."""
    package = _wheel()
    if package is not None:
        yield from _libraries(package.parent / "cyclonedds.libs", package / ".dylibs")
    prefixes = [Path(environment["CYCLONEDDS_HOME"])] if environment.get("CYCLONEDDS_HOME") else []
    prefixes += [Path(each) for each in environment.get("AMENT_PREFIX_PATH", "").split(os.pathsep) if each]
    if _ROS_FOLDER.is_dir():  # the newest distribution has the last letter
        prefixes += sorted(_ROS_FOLDER.iterdir(), reverse=True)
    for prefix in prefixes:
        yield from _libraries(*_library_folders(prefix))
    for pattern in _SYSTEM_FOLDERS:
        yield from _libraries(*map(Path, sorted(glob.glob(pattern))))  # noqa: PTH207


def _wheel() -> Path | None:
    """Return where the wheel's package lies, without importing its classes, which takes 0.2 s."""
    spec = importlib.util.find_spec("cyclonedds")
    return Path(spec.origin).parent if spec is not None and spec.origin is not None else None


def _library_folders(prefix: Path) -> list[Path]:
    return [prefix / "lib", *sorted(prefix.glob("lib/*-linux-gnu*")), prefix / "lib64", prefix / "bin"]


def _libraries(*folders: Path) -> Iterator[Path]:
    for folder in folders:
        for name in _NAMES:
            yield from sorted(folder.glob(name), reverse=True)  # the longest name tells the version


def _load(path: Path) -> ct.CDLL:
    """Load a library, and before it those beside it that it needs: a ROS 2 that is not sourced has its own."""
    for _ in range(_MAX_LACKING):
        try:
            return ct.CDLL(str(path))
        except OSError as error:
            lacking = _LACKING.match(str(error))
            beside = [folder / lacking[1] for folder in (path.parent, path.parent.parent)] if lacking else []
            needed = next((file for file in beside if file.is_file()), None)
            if needed is None or needed == path:
                raise
            _load(needed)
    raise OSError("it needs too many others")


def _advice() -> str:
    if sys.platform != "linux":
        return "Install the wheel, which this Python has if it is 3.10 to 3.13: pip install cyclonedds==11.0.1"
    machine, python = platform.machine(), ".".join(platform.python_version_tuple()[:2])
    wheel = f"with Python 3.10 to 3.13 on x86_64 (this is {python} on {machine}) pip install cyclonedds==11.0.1"
    return (
        "Install one: sudo apt install cyclonedds-tools (Debian 12 and Ubuntu 24.04, or later), or "
        f"ros-<distribution>-cyclonedds of ROS 2, or {wheel}. One that lies elsewhere is found by CYCLONEDDS_HOME"
    )
