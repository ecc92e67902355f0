"""Zstandard: of the standard library from Python 3.14 on, else of its backport; of a tenth of the size of others."""

from __future__ import annotations

from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from backports import zstd
else:
    try:
        from compression import zstd
    except ImportError:
        from backports import zstd

__all__ = ["Compressor", "Parameter", "Strategy", "ZstdError", "content_size", "decompress"]

Parameter, Strategy = zstd.CompressionParameter, zstd.Strategy
ZstdError = zstd.ZstdError


class Compressor:
    """Compresses one frame after the other, each of which states its size; serves one thread at a time."""

    def __init__(self, *, level: int | None = None, options: dict[int, int] | None = None) -> None:
        self._compressor = zstd.ZstdCompressor(level=level, options=options)

    def compress(self, data: bytes | bytearray | memoryview) -> bytes:
        """Return ``data`` as a frame."""
        frame: bytes = self._compressor.compress(data, zstd.ZstdCompressor.FLUSH_FRAME)
        return frame


def content_size(frame: bytes | bytearray | memoryview) -> int | None:
    """Return what the head of a frame says of its size. Raises ``ZstdError``."""
    return zstd.get_frame_info(frame).decompressed_size


def decompress(frame: bytes | bytearray | memoryview, size: int) -> bytes:
    """Return the content of a frame that states ``size``. Raises ``ZstdError``, also if it is not whole."""
    decompressor = zstd.ZstdDecompressor()
    content: bytes = decompressor.decompress(frame, max_length=max(size, 1))
    if not decompressor.eof:
        raise ZstdError("it is cut off")
    if decompressor.unused_data:
        raise ZstdError(f"{len(decompressor.unused_data)} bytes follow its end")
    return content
