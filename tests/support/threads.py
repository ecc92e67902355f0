"""Which threads a test has started, whatever others still run."""

from __future__ import annotations

import threading
from collections.abc import Callable


def new_threads() -> Callable[[], list[str]]:
    """Return a function that names the threads of ours that were started since and still run, in alphabetical order.

    Threads of earlier tests may end meanwhile, and the event loop starts some of its own, for name resolution and the
    like: a count of all threads tells nothing.
    """
    before = set(threading.enumerate())

    def started() -> list[str]:
        names = [thread.name for thread in threading.enumerate() if thread not in before]
        return sorted(name for name in names if not name.startswith("asyncio_"))

    return started
