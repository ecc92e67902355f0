"""Room for many connections: each is an open file to the system, and many systems allow 1,024 by default."""

from __future__ import annotations

import logging
from typing import Final

__all__ = ["allow_open_files"]

log = logging.getLogger("ropeway.gateway")

_OTHERS: Final = 512  # files of the gateway itself: graphs, stores, libraries


def allow_open_files(connections: int) -> int:
    """Have the system allow so many connections, as far as it may; how many files may be open now.

    Call it once graphs are open: a library that knows only the first 1,024 files has its own by then. Says in the log
    if fewer connections than wanted have room. 0 where the system knows no such limit.
    """
    try:
        import resource
    except ImportError:  # Windows
        return 0
    wanted = connections + _OTHERS
    soft, hard = resource.getrlimit(resource.RLIMIT_NOFILE)
    most = wanted if hard == resource.RLIM_INFINITY else min(wanted, hard)
    if soft != resource.RLIM_INFINITY and soft < most:
        try:
            resource.setrlimit(resource.RLIMIT_NOFILE, (most, hard))
            soft = most
        except (OSError, ValueError) as error:
            log.debug("the limit of open files stays at %d: %s", soft, error)
    if soft != resource.RLIM_INFINITY and soft < wanted:
        log.info("the system allows %d open files: there is room for %d connections at most", soft, soft - _OTHERS)
    return soft
