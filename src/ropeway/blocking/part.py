"""Defines the base of every object of ``ropeway.blocking``: it wraps one of asyncio, and can be closed."""

from __future__ import annotations

import contextlib
from collections.abc import Awaitable, Callable
from typing import TYPE_CHECKING, Generic, Protocol, TypeVar

from ropeway.blocking.portal import STEP_S, portal
from ropeway.errors import GraphUnavailable

if TYPE_CHECKING:
    from typing_extensions import Self


__all__ = ["BlockingPart", "BlockingRoot", "opened"]


class _Closable(Protocol):
    async def close(self) -> None: ...


T = TypeVar("T", bound=_Closable)


class BlockingPart(Generic[T]):
    """An object of asyncio that threads use. Safe to use from any thread."""

    def __init__(self, inner: T) -> None:
        self._inner = inner

    def close(self) -> None:
        """Close it; once is enough, and more do no harm."""
        with contextlib.suppress(GraphUnavailable):  # everything was closed
            portal.run(self._inner.close, STEP_S)

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()


class BlockingRoot(BlockingPart[T]):
    """An object that keeps the thread of the loop alive until it is closed."""

    def __init__(self, inner: T) -> None:
        super().__init__(inner)
        portal.keep(self)

    def close(self) -> None:
        """Close it with everything that was made of it; once is enough, and more do no harm."""
        if portal.forget(self):
            try:
                super().close()
            finally:
                portal.leave()


def opened(open: Callable[[], Awaitable[T]], limit_s: float | None) -> T:
    """Return what ``open`` gives on the loop, which then runs until a ``BlockingRoot`` of it is closed."""
    portal.enter()
    try:
        return portal.run(open, limit_s)
    except BaseException:
        portal.leave()
        raise
