"""Finds definition files on disk: single files, source packages, and the ``share`` tree of a ROS 2 workspace."""

from __future__ import annotations

import os
import re
from pathlib import Path
from typing import Final

from ropeway.errors import InvalidDefinition, InvalidTypeName
from ropeway.types.definition import KINDS, canonical_name

__all__ = ["find_in_prefixes", "find_interfaces", "find_share", "read_text"]

_SUFFIXES: Final = (".idl", ".action", ".srv", ".msg")  # a later one wins: .idl files repeat what a .msg says
_NAME: Final = re.compile(r"[A-Za-z][A-Za-z0-9_]*\Z")
_PACKAGE_NAME: Final = re.compile(r"<name>\s*([A-Za-z][A-Za-z0-9_]*)\s*</name>")


def find_interfaces(path: Path) -> dict[str, Path]:
    """Return full names and files of all definitions at or below ``path``.

    A definition stands in a directory ``msg``, ``srv`` or ``action``, whose parent names the package (by its
    ``package.xml`` where there is one, else by its own name). Raises ``InvalidDefinition`` where ``path`` does not
    exist or a file stands elsewhere.
    """
    if path.is_dir():
        found: dict[tuple[str, int], Path] = {}
        packages: dict[Path, str] = {}
        for directory, below, files in os.walk(path):
            below.sort()
            here = Path(directory)
            for file in sorted(files):
                suffix = (here / file).suffix
                if suffix in _SUFFIXES and not file.startswith(".") and (name := _name_of(here / file, packages)):
                    found[name, _SUFFIXES.index(suffix)] = here / file
        return {name: file for (name, _), file in sorted(found.items())}
    if not path.is_file():
        raise InvalidDefinition(path.name, "there is no such file or directory", file=str(path))
    name = _name_of(path.absolute(), {}) if path.suffix in _SUFFIXES else ""
    if not name:
        raise InvalidDefinition(
            path.name, "a definition stands at PACKAGE/msg/Name.msg (or srv, action)", file=str(path)
        )
    return {name: path}


def find_in_prefixes(prefixes: str) -> dict[str, Path]:
    """Return full names and files of all definitions below ``prefixes``, as ``AMENT_PREFIX_PATH`` has them.

    Earlier prefixes win.
    """
    found: dict[str, Path] = {}
    for prefix in prefixes.split(os.pathsep):
        share = Path(prefix) / "share"
        if prefix and share.is_dir():
            found = {**find_share(share), **found}
    return found


def find_share(share: Path) -> dict[str, Path]:
    """Return full names and files of all definitions in the ``share`` directory of an installed workspace.

    Looks into ``<package>/msg``, ``srv`` and ``action`` only, for a whole distribution has much else there.
    """
    found: dict[str, Path] = {}
    with os.scandir(share) as packages:
        for package in sorted(packages, key=lambda entry: entry.name):
            for kind in KINDS:
                directory = os.path.join(package.path, kind)  # noqa: PTH118 - a thousand Path objects are slow
                if not os.path.isdir(directory):  # noqa: PTH112
                    continue
                files = sorted(os.listdir(directory), key=_rank)  # noqa: PTH208
                for base, _, suffix in (file.rpartition(".") for file in files):
                    if f".{suffix}" in _SUFFIXES and _NAME.match(base):
                        found[f"{package.name}/{kind}/{base}"] = Path(directory, f"{base}.{suffix}")
    return found


def _rank(file: str) -> tuple[bool, str]:
    return not file.endswith(".idl"), file


def read_text(path: Path, name: str) -> str:
    """Read the text of a definition file. Raises ``InvalidDefinition`` where it cannot be read."""
    try:
        return path.read_text(encoding="utf-8-sig", errors="replace")
    except OSError as error:
        raise InvalidDefinition(name, error.strerror or str(error), file=str(path)) from error


def _name_of(file: Path, packages: dict[Path, str]) -> str:
    """Return the full name of the type that ``file`` defines, ``""`` if its location does not tell."""
    kind = file.suffix[1:]
    for directory in file.parents:
        if directory.name == kind or (file.suffix == ".idl" and directory.name in KINDS):
            package = packages.get(directory.parent)
            if package is None:
                package = packages[directory.parent] = _package(directory.parent)
            try:
                return canonical_name(f"{package}/{directory.name}/{file.stem}")
            except InvalidTypeName:
                return ""
    return ""


def _package(directory: Path) -> str:
    try:
        found = _PACKAGE_NAME.search((directory / "package.xml").read_text(encoding="utf-8-sig", errors="replace"))
    except OSError:
        found = None
    return found[1] if found else directory.name
