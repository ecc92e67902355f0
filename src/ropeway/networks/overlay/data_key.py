"""Names the keys of Zenoh under which data goes: by global name, publisher and, where it is for one gateway, that."""

from __future__ import annotations

from typing import Final

__all__ = ["data_key", "publisher_of"]

_PUBLISHER: Final = 3  # its place in a key


def data_key(name: bytes, endpoint: bytes | None = None, target: bytes = b"") -> str:
    """Return the key under which a publisher puts the data of a name, all of it or that for one gateway, ``target``.

    ``None`` stands for all publishers.
    """
    key = f"rw/d/{name.hex()}/{'*' if endpoint is None else endpoint.hex()}"
    return f"{key}/{target.hex()}" if target else key


def publisher_of(key: str) -> bytes:
    """Return the publisher whose data comes under a key, ``b""`` where the key names none."""
    text = key.split("/")[_PUBLISHER]
    return bytes.fromhex(text) if len(text) == 32 and all(c in "0123456789abcdef" for c in text) else b""
