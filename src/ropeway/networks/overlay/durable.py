"""Files that are whole after a crash, and changed by one process at a time."""

from __future__ import annotations

import contextlib
import os
import secrets
from collections.abc import Iterator
from pathlib import Path

from ropeway.errors import IdentityError

__all__ = ["locked", "write_durable"]


def write_durable(path: Path, data: bytes) -> None:
    """Put ``data`` in the place of what a file had: after a crash one of the two is there. Raises ``OSError``."""
    new = path.with_name(f".{path.name}.{secrets.token_hex(4)}")
    try:
        with new.open("wb") as file:
            file.write(data)
            file.flush()
            os.fsync(file.fileno())
        new.replace(path)
    except BaseException:
        new.unlink(missing_ok=True)
        raise
    with contextlib.suppress(OSError):  # a file system that cannot keep directories has kept the file
        directory = os.open(path.parent, os.O_RDONLY)
        try:
            os.fsync(directory)
        finally:
            os.close(directory)


@contextlib.contextmanager
def locked(path: Path) -> Iterator[None]:
    """Hold the lock of a file, made if it is not there; wait for whoever holds it. Raises ``IdentityError``."""
    try:
        file = path.open("a")
    except OSError as error:
        raise IdentityError(str(path), f"it cannot be written: {error.strerror}") from error
    with file:
        try:
            import fcntl
        except ImportError:  # Windows, where fleets are kept by one person at a time
            yield
            return
        fcntl.flock(file, fcntl.LOCK_EX)  # closing the file, or the end of the process, lets it go
        yield
