"""Finds the files that viewers fetch, such as the meshes of a robot: of configured packages, and nothing else."""

from __future__ import annotations

import os
import stat
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Final
from urllib.parse import unquote

from ropeway.errors import RopewayError
from ropeway.limits import ASSET_BYTES

if TYPE_CHECKING:
    from ropeway.networks.foxglove.settings import FoxgloveSettings

__all__ = ["AssetRefused", "Assets"]

_SCHEME: Final = "package://"
_OPEN: Final = os.O_RDONLY | os.O_NONBLOCK | os.O_CLOEXEC  # a pipe that nobody writes keeps no thread


class AssetRefused(RopewayError):
    """A file cannot be had; the text is for the viewer, and tells nothing of the places of files here."""


class Assets:
    """Reads files by their names ``package://NAME/PATH``, from the directory ``NAME`` of one of the roots.

    A path leads out of its package neither by its parts nor by a symbolic link.
    """

    def __init__(self, settings: FoxgloveSettings) -> None:
        self._settings = settings
        self._roots: Sequence[Path] = [root.resolve() for root in settings.asset_roots]

    def read(self, uri: str) -> bytes:
        """Return the content of a file; blocks. Raises ``AssetRefused``."""
        package, parts = self._split(uri)
        for root in self._roots:
            home = root / package
            path = self._inside(home, parts)
            if path is not None:
                return _content(path, uri)
        raise AssetRefused(f"{uri} is not there")

    def _split(self, uri: str) -> tuple[str, list[str]]:
        """Return the package of a name and the parts of its path. Raises ``AssetRefused``."""
        if not uri.startswith(_SCHEME):
            raise AssetRefused("only package:// files are served here, as in package://my_robot/meshes/arm.stl")
        if not self._settings.serves_asset(uri):
            raise AssetRefused(f"{uri} matches no pattern of asset_uri_allowlist")
        package, *parts = unquote(uri.removeprefix(_SCHEME)).split("/")
        if not parts or any(part in ("", ".", "..") or "\0" in part or "\\" in part for part in (package, *parts)):
            raise AssetRefused(f"{uri} is not the name of a file in a package")
        return package, parts

    def _inside(self, home: Path, parts: Sequence[str]) -> Path | None:
        """Return a file of the package ``home``; ``None`` if there is none, or if it is not in there."""
        try:
            base = home.resolve(strict=True)
            path = home.joinpath(*parts).resolve(strict=True)
        except (OSError, RuntimeError, ValueError):
            return None
        inside = path.is_relative_to(base) and any(base.is_relative_to(root) for root in self._roots)
        return path if inside else None


def _content(path: Path, uri: str) -> bytes:
    try:
        number = os.open(path, _OPEN)
    except OSError as error:
        raise AssetRefused(f"{uri} cannot be read: {error.strerror}") from None
    try:
        about = os.fstat(number)
        if not stat.S_ISREG(about.st_mode):
            raise AssetRefused(f"{uri} is not a file")
        if about.st_size > ASSET_BYTES:
            raise AssetRefused(f"{uri} has {about.st_size} bytes; at most {ASSET_BYTES} are sent")
        with os.fdopen(number, "rb", closefd=False) as file:
            content = file.read(about.st_size)  # and no more, should it grow
    except OSError as error:
        raise AssetRefused(f"{uri} cannot be read: {error.strerror}") from None
    finally:
        os.close(number)
    return content
