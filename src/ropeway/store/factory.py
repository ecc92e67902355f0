"""Stores by URL: ``values.sqlite``, a directory with JSON files, ``mongodb://host/database``, ``memory:``."""

from __future__ import annotations

import os
import re
from pathlib import Path
from typing import Final

from ropeway.store.entry import Backend, SharedBackend

__all__ = ["default_path", "is_mongo", "make_backend", "make_mirror"]

_MONGO: Final = re.compile(r"mongodb(\+srv)?://")


def is_mongo(url: str) -> bool:
    """Return whether ``url`` is that of a MongoDB database."""
    return _MONGO.match(url) is not None


def make_backend(url: str) -> Backend:
    """Make the backend for ``url``: MongoDB for its URLs, JSON files for a directory (or a path that ends in a slash),
    nothing for ``memory:``, and otherwise an SQLite file.
    """
    if is_mongo(url):
        return make_mirror(url)
    if url != "memory:" and (url.endswith("/") or Path(url).expanduser().is_dir()):
        from ropeway.store.files import FilesBackend

        return FilesBackend(url)
    from ropeway.store.sqlite import SqliteBackend

    return SqliteBackend(":memory:" if url == "memory:" else url)


def make_mirror(url: str) -> SharedBackend:
    """Return the database elsewhere at a URL of MongoDB, for use as a mirror."""
    from ropeway.store.mongo import MongoBackend

    return MongoBackend(url)


def default_path(name: str) -> str:
    """Return where the gateway ``name`` keeps its values: under ``XDG_STATE_HOME``, or ``~/.local/state``."""
    state = os.environ.get("XDG_STATE_HOME") or "~/.local/state"
    return str(Path(state).expanduser() / "ropeway" / f"{name}.sqlite")
