"""Files of keys, certificates, requests and bundles: others may have written them, and damaged them."""

from __future__ import annotations

import contextlib
from collections.abc import Iterator
from pathlib import Path
from typing import Final

from ropeway.errors import IdentityError
from ropeway.limits import OVERLAY_FILE_BYTES

__all__ = ["SECRET_BYTES", "read_material", "read_material_text", "read_secret", "understood"]

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
