"""Claims the UNIX socket of a gateway: that of a dead process is replaced, that of a living one is left alone."""

from __future__ import annotations

import contextlib
import fcntl
import os
import socket
import stat
from pathlib import Path
from typing import Final

from ropeway.errors import ControlUnavailable, NameTaken

__all__ = ["SocketClaim"]

_BACKLOG: Final = 64
_ANSWER_S: Final = 1.0  # a process that listens accepts at once


class SocketClaim:
    """A UNIX socket that is bound, and the lock beside it that says its owner lives.

    The lock ends with the process, however it ends; so a socket without a locked file is a dead one's.
    """

    def __init__(self, path: Path) -> None:
        """Bind the socket. Raises ``NameTaken`` or ``ControlUnavailable``."""
        self.path = path
        self._lock = os.open(path.with_suffix(".lock"), os.O_RDWR | os.O_CREAT | os.O_CLOEXEC | os.O_NOFOLLOW, 0o600)
        try:
            self._take_lock()
            self._remove_stale()
            self.socket = self._bound()
        except BaseException:
            os.close(self._lock)
            raise

    def close(self) -> None:
        """Remove the socket, so that nobody looks for us."""
        with contextlib.suppress(OSError):
            if self._inode is not None and self.path.lstat().st_ino == self._inode:
                self.path.unlink()
        self.socket.close()
        os.close(self._lock)

    def _take_lock(self) -> None:
        try:
            fcntl.flock(self._lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except OSError:
            owner = os.pread(self._lock, 32, 0).decode(errors="replace").strip()
            raise NameTaken(str(self.path), f"process {owner or 'unknown'} runs a gateway of this name") from None
        os.ftruncate(self._lock, 0)
        os.pwrite(self._lock, f"{os.getpid()}\n".encode(), 0)

    def _remove_stale(self) -> None:
        try:
            found = self.path.lstat()
        except FileNotFoundError:
            return
        if not stat.S_ISSOCK(found.st_mode):
            raise ControlUnavailable(str(self.path), "is there and is no socket; remove it, or choose another name")
        if found.st_uid != os.geteuid():
            text = f"is a socket of the user with number {found.st_uid}; choose another name (gateway.control.name)"
            raise ControlUnavailable(str(self.path), text)
        with contextlib.closing(socket.socket(socket.AF_UNIX, socket.SOCK_STREAM)) as probe:
            probe.settimeout(_ANSWER_S)
            try:
                probe.connect(str(self.path))
            except OSError:
                self.path.unlink(missing_ok=True)
                return
        raise NameTaken(str(self.path), "another process listens there")

    def _bound(self) -> socket.socket:
        made = socket.socket(socket.AF_UNIX, socket.SOCK_STREAM)
        try:
            made.setblocking(False)
            os.fchmod(made.fileno(), 0o600)  # Linux gives the file the mode of the socket
            made.bind(str(self.path))
            self.path.chmod(0o600)
            made.listen(_BACKLOG)
            self._inode: int | None = self.path.lstat().st_ino
        except OSError as error:
            made.close()
            raise ControlUnavailable(str(self.path), f"cannot be bound: {error.strerror or error}") from None
        return made
