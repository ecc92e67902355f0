"""Finds the UNIX sockets of gateways: in a directory that belongs to the user alone, one by the name of each."""

from __future__ import annotations

import os
import stat
import tempfile
from collections.abc import Mapping
from pathlib import Path
from typing import Final

from ropeway.errors import ControlUnavailable

__all__ = ["SUFFIX", "own_directory", "running", "search_directories", "socket_path"]

SUFFIX: Final = ".sock"

_SERVICE_DIRECTORY: Final = Path("/run/ropeway")  # RuntimeDirectory=ropeway of a systemd unit
_LONGEST_PATH_BYTES: Final = 107  # of the address of a UNIX socket on Linux


def own_directory(environ: Mapping[str, str] = os.environ) -> Path:
    """Return the directory for the sockets of this user's gateways, made where it is missing.

    That is below ``RUNTIME_DIRECTORY`` of a service, ``XDG_RUNTIME_DIR`` of a session, or else a private one for
    temporary files. Raises ``ControlUnavailable`` where it cannot be trusted.
    """
    service = environ.get("RUNTIME_DIRECTORY", "").partition(":")[0]
    if service:
        return Path(service)
    directory = _session_directory(environ) or _private_directory()
    try:
        directory.mkdir(mode=0o700, parents=True, exist_ok=True)
        found = directory.lstat()
    except OSError as error:
        raise ControlUnavailable(str(directory), f"cannot be made: {error.strerror or error}") from None
    if not stat.S_ISDIR(found.st_mode):
        raise ControlUnavailable(str(directory), "is no directory; remove it, or set XDG_RUNTIME_DIR")
    if found.st_uid != os.geteuid():
        text = f"belongs to the user with number {found.st_uid}, not to us; set XDG_RUNTIME_DIR to a directory of yours"
        raise ControlUnavailable(str(directory), text)
    if found.st_mode & 0o077:
        directory.chmod(0o700)
    return directory


def search_directories(environ: Mapping[str, str] = os.environ) -> list[Path]:
    """Return where sockets are looked for: this user's directories, then that of a service."""
    found = [Path(environ["RUNTIME_DIRECTORY"].partition(":")[0])] if environ.get("RUNTIME_DIRECTORY") else []
    session = _session_directory(environ)
    found += [session] if session is not None else []
    return list(dict.fromkeys([*found, _private_directory(), _SERVICE_DIRECTORY]))


def socket_path(directory: Path, name: str) -> Path:
    """Return where the socket of a gateway is. Raises ``ControlUnavailable`` where the path is too long for one."""
    path = directory / f"{name}{SUFFIX}"
    if len(os.fsencode(path)) > _LONGEST_PATH_BYTES:
        text = f"is longer than the {_LONGEST_PATH_BYTES} bytes of a UNIX socket; set XDG_RUNTIME_DIR to a shorter path"
        raise ControlUnavailable(str(path), text)
    return path


def running(environ: Mapping[str, str] = os.environ) -> dict[str, Path]:
    """Return the sockets that are there, by the names of their gateways; the processes may be gone."""
    found: dict[str, Path] = {}
    for directory in search_directories(environ):
        try:
            listed = sorted(directory.glob(f"*{SUFFIX}"))
        except OSError:
            continue
        for path in listed:
            found.setdefault(path.name.removesuffix(SUFFIX), path)
    return found


def _session_directory(environ: Mapping[str, str]) -> Path | None:
    session = environ.get("XDG_RUNTIME_DIR")
    return Path(session) / "ropeway" if session and Path(session).is_dir() else None


def _private_directory() -> Path:
    return Path(tempfile.gettempdir()) / f"ropeway-{os.geteuid()}"
