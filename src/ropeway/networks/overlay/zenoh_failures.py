"""Turns failures of Zenoh that Python does not know into errors that callers expect."""

from __future__ import annotations

import contextlib
from collections.abc import Iterator

from ropeway.errors import GraphUnavailable

__all__ = ["zenoh_failures"]


@contextlib.contextmanager
def zenoh_failures() -> Iterator[None]:
    """Raise ``GraphUnavailable`` where Zenoh has failed within: its panics are no ``Exception``."""
    try:
        yield
    except BaseException as error:
        if type(error).__name__ == "PanicException":  # of a module that cannot be imported
            raise GraphUnavailable("overlay", "Zenoh has failed; links are made anew") from error
        raise
