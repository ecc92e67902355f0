"""Files of keys, certificates, requests and bundles: others may have written them, and damaged them."""

from __future__ import annotations

import contextlib
import logging
import os
from collections.abc import Iterator
from pathlib import Path
from typing import Final

from ropeway.errors import IdentityError
from ropeway.limits import OVERLAY_FILE_BYTES

__all__ = ["SECRET_BYTES", "check_private", "read_material", "read_material_text", "read_secret", "understood"]

log = logging.getLogger("ropeway.overlay")

SECRET_BYTES: Final = 32
"""The secret that global names are made under."""


def read_material(path: Path) -> bytes:
    """Return what is in a file. Raises ``IdentityError`` where it cannot be read, or is too large to be meant."""
    try:
        with path.open("rb") as file:
            data = file.read(OVERLAY_FILE_BYTES + 1)
    except OSError as error:
        raise IdentityError(str(path), f"it cannot be read: {error.strerror}") from error
    if len(data) > OVERLAY_FILE_BYTES:
        raise IdentityError(str(path), f"it has more than {OVERLAY_FILE_BYTES >> 20} MiB; name another file")
    return data


def read_material_text(path: Path) -> str:
    """Return the text in a file. Raises ``IdentityError``."""
    data = read_material(path)
    try:
        return data.decode()
    except UnicodeDecodeError as error:
        raise IdentityError(str(path), f"it cannot be read: {error}") from error


def check_private(path: Path) -> None:
    """Refuse a file of our own that others can read; one of somebody else, as a mounted secret, is only told of.

    Raises ``IdentityError`` that says what to do.
    """
    if os.name != "posix":
        return
    found = path.stat()
    if not found.st_mode & 0o077 or _is_credential(path):
        return
    text = f"others can read it (mode {found.st_mode & 0o777:04o}), and may have its key"
    if found.st_uid == os.geteuid():
        raise IdentityError(str(path), f"{text}; keep it to yourself with: chmod 600 {path}")
    log.warning("%s: %s; its owner keeps it secret with chmod 600", path, text)


def _is_credential(path: Path) -> bool:
    """Return whether a service manager put the file where this service alone can read it, whatever its mode says."""
    directory = os.environ.get("CREDENTIALS_DIRECTORY")
    return directory is not None and path.absolute().is_relative_to(directory)


def read_secret(text: str) -> bytes:
    """Return the name secret that ``text`` has in hexadecimal digits. Raises ``ValueError``."""
    secret = bytes.fromhex(text)
    if len(secret) != SECRET_BYTES:
        raise ValueError(f"the name secret has {len(secret)} bytes, not {SECRET_BYTES}")
    return secret


@contextlib.contextmanager
def understood(source: str, otherwise: str, hint: str = "") -> Iterator[None]:
    """Raise ``IdentityError`` about ``source`` for whatever fails in the block, which reads what others wrote.

    The library that reads certificates raises errors of many kinds, some of them only ``Exception`` by class.
    """
    try:
        yield
    except IdentityError:
        raise
    except Exception as error:  # of a library that reads what others wrote, which raises many kinds
        text = " ".join(str(error).split())[:200] or type(error).__name__
        raise IdentityError(source, f"{otherwise} ({text}){hint}") from error
