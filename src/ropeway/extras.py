"""Names the extras of the package: what only some users need, and is installed by ``pip install 'ropeway[NAME]'``."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from importlib.util import find_spec
from typing import Final

from ropeway.errors import MissingExtra

__all__ = ["EXTRAS", "needing", "require"]

EXTRAS: Final = {
    "bags": ("apsw", "mcap", "rosbags", "zstandard"),
    "dashboard": ("nicegui",),
    "demo": ("matplotlib",),
    "mongo": ("pymongo",),
    "mqtt": ("paho",),
    "overlay": ("zenoh",),
    "zenoh": ("xxhash", "zenoh"),
}
"""The modules that each extra brings."""


def require(extra: str, purpose: str) -> None:
    """Raise ``MissingExtra`` if the modules of an extra are not installed; ``purpose`` says who needs them."""
    if any(find_spec(module) is None for module in EXTRAS[extra]):
        raise MissingExtra(extra, purpose)


@contextmanager
def needing(purpose: str) -> Iterator[None]:
    """Raise ``MissingExtra`` if an import in the block fails because an extra is not installed."""
    try:
        yield
    except ModuleNotFoundError as error:
        module = (error.name or "").partition(".")[0]
        extra = next((extra for extra, modules in EXTRAS.items() if module in modules), None)
        if extra is None:
            raise
        raise MissingExtra(extra, purpose) from error
