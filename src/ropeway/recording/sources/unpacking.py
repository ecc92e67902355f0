"""Unpacks what recorders have compressed, as far as it may grow: a recording may come from anybody.

A kilobyte of a hostile file unpacks to a gigabyte, so neither the disk nor the memory may depend on what it says of
itself.
"""

from __future__ import annotations

import bz2
import shutil
from pathlib import Path
from typing import Any, Final

import lz4.frame
import zstandard

from ropeway.limits import RECORDING_DISK_BYTES, RECORDING_UNPACKED_BYTES

__all__ = ["CHUNK_BYTES", "Unpacker", "unpacked_bz2", "unpacked_lz4"]

CHUNK_BYTES: Final = 256 << 20
"""A chunk, or a message that was compressed alone: writers close a chunk at some MiB, or after one message. What says
that it has more, or has it, is damage, or hostile."""

_STEP_BYTES: Final = 1 << 20
_CHECK_BYTES: Final = 64 << 20  # written between two looks at what the disk has free


class Unpacker:
    """Unpacks the files and messages of one recording; ``left_bytes`` is what its files may still take."""

    def __init__(
        self, *, most_bytes: int = RECORDING_UNPACKED_BYTES, reserve_bytes: int = RECORDING_DISK_BYTES
    ) -> None:
        self.left_bytes = most_bytes
        self._most_bytes, self._reserve_bytes = most_bytes, reserve_bytes
        self._messages = zstandard.ZstdDecompressor()

    def file(self, packed: Path, target: Path) -> None:
        """Unpack a file that was compressed as a whole.

        Raises ``ValueError``, and leaves no target, where it takes more than files of one recording may, or would fill
        the disk of the target.
        """
        try:
            with packed.open("rb") as source, target.open("wb") as out:
                unpacking = zstandard.ZstdDecompressor().stream_reader(source)
                unchecked = _CHECK_BYTES
                while step := unpacking.read(_STEP_BYTES):
                    self.left_bytes -= len(step)
                    if self.left_bytes < 0:
                        raise ValueError(
                            f"{packed.name} is refused: unpacked, the recording takes more than "
                            f"{_gigabytes(self._most_bytes)}; unpack it with zstd -d, and play what is unpacked"
                        )
                    if unchecked >= _CHECK_BYTES:
                        unchecked = 0
                        self._check_disk(packed, target)
                    unchecked += len(step)
                    out.write(step)
        except BaseException:
            target.unlink(missing_ok=True)
            raise

    def message(self, packed: bytes) -> bytes:
        """Return a message that was compressed alone. Raises ``ValueError`` for a large one, and ``DAMAGED``."""
        if zstandard.frame_content_size(packed) > CHUNK_BYTES:  # which is allocated, whatever follows
            raise _too_large("message")
        return self._messages.decompress(packed, max_output_size=CHUNK_BYTES)

    def _check_disk(self, packed: Path, target: Path) -> None:
        if shutil.disk_usage(target.parent).free < self._reserve_bytes + _CHECK_BYTES:
            raise ValueError(
                f"{packed.name} is refused: unpacked, it would leave less than {_gigabytes(self._reserve_bytes)} free "
                f"in {target.parent.parent}; name a directory with more room in TMPDIR"
            )


def unpacked_bz2(packed: bytes) -> bytes:
    """Return a chunk of a bag of ROS 1. Raises ``ValueError`` for more than a chunk has, and ``DAMAGED``."""
    return _whole(bz2.BZ2Decompressor(), packed)


def unpacked_lz4(packed: bytes) -> bytes:
    """Return a chunk of a bag of ROS 1. Raises ``ValueError`` for more than a chunk has, and ``DAMAGED``."""
    return _whole(lz4.frame.LZ4FrameDecompressor(), packed)


def _whole(unpacking: Any, packed: bytes) -> bytes:
    found: bytes = unpacking.decompress(packed, max_length=CHUNK_BYTES + 1)
    if len(found) > CHUNK_BYTES:
        raise _too_large("chunk")
    if not unpacking.eof:
        raise EOFError
    return found


def _too_large(what: str) -> ValueError:
    return ValueError(f"a {what} is refused: unpacked, it has more than {CHUNK_BYTES >> 20} MiB")


def _gigabytes(size: int) -> str:
    return f"{size / (1 << 30):g} GiB"
