"""Names the keys of Zenoh under which data goes: by global name, publisher and, where it is for one gateway, that."""

from __future__ import annotations

from typing import Final

__all__ = ["data_key", "name_of", "publisher_of"]

_NAME: Final = 2  # their places in a key
_PUBLISHER: Final = 3


def data_key(name: bytes | None = None, endpoint: bytes | None = None, target: bytes = b"") -> str:
    """Return the key under which a publisher puts the data of a name, all of it or that for one gateway, ``target``.

    ``None`` stands for all names, or all publishers.
    """
    key = f"rw/d/{'*' if name is None else name.hex()}/{'*' if endpoint is None else endpoint.hex()}"
    return f"{key}/{target.hex()}" if target else key


def name_of(key: str) -> bytes:
    """Return the global name whose data comes under a key, ``b""`` where the key names none."""
    return _bytes(key.split("/")[_NAME], 64)


def publisher_of(key: str) -> bytes:
    """Return the publisher whose data comes under a key, ``b""`` where the key names none."""
    return _bytes(key.split("/")[_PUBLISHER], 32)


def _bytes(text: str, length: int) -> bytes:
    return bytes.fromhex(text) if len(text) == length and all(c in "0123456789abcdef" for c in text) else b""
