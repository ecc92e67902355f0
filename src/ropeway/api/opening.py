"""Defines objects that are opened when awaited, and closed at the end of a block."""

from __future__ import annotations

from collections.abc import Coroutine, Generator
from typing import TYPE_CHECKING, Any, Generic, NoReturn, TypeVar

if TYPE_CHECKING:
    from typing_extensions import Self


__all__ = ["Closing", "Opening"]


class Closing:
    """An open object, which ``async with`` closes at the end of the block."""

    async def close(self) -> None:
        """Close it; once is enough, and more do no harm."""
        raise NotImplementedError

    async def __aenter__(self) -> Self:
        return self

    async def __aexit__(self, *_: object) -> None:
        await self.close()


T = TypeVar("T", bound=Closing)


class Opening(Generic[T]):
    """A ``Closing`` object that is about to be opened.

    ``await`` it to get the object and close that yourself, or enter it with ``async with``, which closes the object at
    the end of the block.
    """

    def __init__(self, work: Coroutine[Any, Any, T]) -> None:
        self._work = work
        self._opened: T | None = None

    def __await__(self) -> Generator[Any, Any, T]:
        return self._work.__await__()

    async def __aenter__(self) -> T:
        self._opened = await self._work
        return self._opened

    async def __aexit__(self, *_: object) -> None:
        assert self._opened is not None
        await self._opened.close()

    def __enter__(self) -> NoReturn:
        self._work.close()
        raise TypeError("write 'async with', or use ropeway.blocking, which is for programs without asyncio")

    def __exit__(self, *_: object) -> None: ...

    if not TYPE_CHECKING:  # to type checkers it has no other attributes

        def __getattr__(self, name: str) -> NoReturn:
            raise AttributeError(
                f"it is not open yet, so it has no {name!r}: await it first, or enter it with 'async with'"
            )
